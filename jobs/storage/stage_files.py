"""Names of the files by which stages hand their results on. Those of products are in `dynamictree.export.table`."""

MESH = "mesh.ply"  # a reconstructed mesh, to look at
MESH_BUNDLE = "mesh.safetensors"  # a reconstructed mesh, for the next stages
CLOUD_BUNDLE = "cloud.safetensors"  # a splat or scan as it was read, for the stages that move it
VOXELS = "tree.voxels.safetensors"
SPECTRUM = "tree.spectrum.safetensors"
STILL = "still.webp"  # of 2 to 8 kB, beside `preview.png`

STAGE_VERSION = "30"
"""Part of every stage's key; raised when a stage makes something else of the same inputs."""
HALF_DONE = "half-done-"
"""First part of the names of folders in scratch that hold half-done reconstructions."""
