"""`*.voxels.safetensors`: occupied voxels and the normals of the surface in them. See docs/formats.md."""

import numpy as np

from dynamictree.errors import FormatError
from dynamictree.formats.stream import ByteReader, ByteWriter
from dynamictree.formats.tensor_file import grid_metadata, read_grid, read_tensors, take_tensor, write_tensors
from dynamictree.voxel.voxelize import SurfaceVoxels

FORMAT = "surface-voxels"
VERSION = "1"

_LONGEST_NORMAL = 1.01  # unit length and rounding; zero says that the direction is not known


def write_voxels(voxels: SurfaceVoxels, stream: ByteWriter) -> None:
    """Write; undone by `read_voxels` bit by bit."""
    metadata = {"format": FORMAT, "version": VERSION, **grid_metadata(voxels.grid)}
    write_tensors(stream, {"coords": voxels.grid.coords, "normals": voxels.normals}, metadata)


def read_voxels(stream: ByteReader) -> SurfaceVoxels:
    """Read.

    Raises:
        InputError: the file holds no voxels of a known version, or anything in it is out of range.
    """
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION)
    grid = read_grid(tensors, metadata)
    normals = take_tensor(tensors, "normals", dtypes=("float32",), shape=(len(grid), 3))
    longest = float(np.linalg.norm(normals, axis=1).max())
    if longest > _LONGEST_NORMAL:
        raise FormatError(f"a normal is {longest:.4g} long; normals have unit length")
    return SurfaceVoxels(grid=grid, normals=normals)
