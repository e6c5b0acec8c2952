"""Names of the files that stages make, and what each is."""

from pathlib import PurePosixPath

MESH = "mesh.ply"  # reconstructed, to look at
MESH_BUNDLE = "mesh.safetensors"  # reconstructed, for the stages after
CLOUD_BUNDLE = "cloud.safetensors"  # a splat or scan as it was read, for the stages that move it
VOXELS = "tree.voxels.safetensors"
SPECTRUM = "tree.spectrum.safetensors"

_MEDIA_TYPES = {
    ".zip": "application/zip",
    ".glb": "model/gltf-binary",
    ".usdz": "model/vnd.usdz+zip",
    ".png": "image/png",
    ".webp": "image/webp",
    ".mp4": "video/mp4",
}


def media_type(name: str) -> str:
    """What a file is, by the end of its name."""
    return _MEDIA_TYPES.get(PurePosixPath(name).suffix, "application/octet-stream")
