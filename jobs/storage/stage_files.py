"""Names of the files that stages pass on. Those of products are in `dynamictree.export.table`."""

MESH = "mesh.ply"  # a reconstructed mesh, for viewing
MESH_BUNDLE = "mesh.safetensors"  # a reconstructed mesh, for the next stages
CLOUD_BUNDLE = "cloud.safetensors"  # a splat or scan as it was read, for the stages that move it
VOXELS = "tree.voxels.safetensors"
SPECTRUM = "tree.spectrum.safetensors"
STILL = "still.webp"  # small preview (2 to 8 kB) beside `preview.png`

STAGE_VERSION = "39"
"""Part of every stage's key; raised when the output of a stage changes for the same inputs."""
HALF_DONE = "half-done-"
"""Prefix of the scratch folders of half-done reconstructions."""
