"""`*.voxels.safetensors`: occupied voxels, normals and moments of the surface in them. See docs/formats.md."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32, Shaped

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.errors import FormatError
from dynamictree.formats.tensors.container import (
    GridFacts,
    checked_tensor,
    facts_of,
    grid_metadata,
    read_grid,
    read_tensors,
    source_metadata,
    tree_numbers,
    write_tensors,
)
from dynamictree.voxel.moments import AREA, NUM_MOMENTS
from dynamictree.voxel.voxelize import SurfaceVoxels

FORMAT = "surface-voxels"
VERSION = "1"


def write_voxels(voxels: SurfaceVoxels, stream: ByteWriter) -> None:
    """Write voxels; `read_voxels` restores them exactly."""
    metadata = {"format": FORMAT, "version": VERSION, **grid_metadata(voxels.grid), **source_metadata(voxels.source)}
    moments = {} if voxels.moments is None else {"moments": voxels.moments}
    tree = {} if voxels.tree is None else {"tree": voxels.tree}
    write_tensors(stream, {"coords": voxels.grid.coords, "normals": voxels.normals, **moments, **tree}, metadata)


def read_voxels(stream: ByteReader) -> SurfaceVoxels:
    """Read voxels.

    Raises:
        InputError: the file has no voxels of a known version, or anything in it is out of range.
    """
    longest_normal = 1.01  # unit length plus rounding; zero is an unknown direction
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION)
    facts = facts_of(metadata, GridFacts)
    grid = read_grid(tensors, facts)
    normals = checked_tensor(tensors, "normals", dtypes=("float32",), shape=(len(grid), 3))
    longest = float(np.linalg.norm(normals, axis=1).max())
    if longest > longest_normal:
        raise FormatError(f"a normal is {longest:.4g} long; normals have unit length")
    moments, tree = _moments(tensors, len(grid)), tree_numbers(tensors, len(grid))
    return SurfaceVoxels(grid=grid, normals=normals, moments=moments, tree=tree, source=facts.source)


def _moments(tensors: Mapping[str, Shaped[np.ndarray, "..."]], num_voxels: int) -> Float32[np.ndarray, "V 16"] | None:
    largest_moment = 1.01  # moments except the area: offsets and spreads lie inside a voxel, normals have unit length
    if "moments" not in tensors:
        return None
    moments = checked_tensor(tensors, "moments", dtypes=("float32",), shape=(num_voxels, NUM_MOMENTS))
    if (moments[:, AREA] <= 0).any() or float(np.abs(moments[:, AREA.stop :]).max()) > largest_moment:
        raise FormatError("moments have an area above 0, and lie within a voxel; voxelise the mesh again")
    return moments
