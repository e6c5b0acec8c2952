"""Training targets of the foliage network (see `foliage.py`), computed from the dataset's trees."""

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Int64
from scipy.spatial import cKDTree
from torch import Tensor

from dynamictree.mesh import Surface, connected_parts
from dynamictree.models.small.foliage import ARM_SCALE, NUM_PARTS
from dynamictree.models.wind import log_wind_scale
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import surface_average
from lab.dataset.sapling import LEAF
from lab.dataset.shards import StoredTree

SHORTEST_M = 1e-3
LEAST_SIZE = 1e-5
"""Smallest motion [share of the height]; smaller ones are raised to it."""


def foliage_targets_of(
    stored: StoredTree, spectrum: Complex64[Tensor, "V K 3"], *, resolution: int = 128
) -> Float32[Tensor, "V O"]:
    """Return the targets of each voxel; `spectrum` is divided by the height, in the wind's frame."""
    parts = torch.from_numpy(true_parts(stored, stored.voxels(resolution).grid))
    return torch.cat([parts, log_size(spectrum, stored.wind)], dim=1)


def log_size(spectrum: Complex64[Tensor, "V K 3"], wind: Wind) -> Float32[Tensor, "V J"]:
    """Return ln(|c_k| / height) at drag and gust 1."""
    power = spectrum[:, 1:].abs().square().sum(dim=2)
    return (power + LEAST_SIZE**2).log() / 2 - log_wind_scale(wind)


def true_parts(stored: StoredTree, grid: VoxelGrid) -> Float32[np.ndarray, "V 10"]:
    """Average the vertices' part labels over the surface in each voxel."""
    mesh = stored.mesh()
    at_vertex = _at_vertices(stored, mesh)
    return np.asarray(surface_average(mesh, grid) @ at_vertex, np.float32)


def _at_vertices(stored: StoredTree, mesh: Surface) -> Float32[np.ndarray, "N 10"]:
    vertices, skeleton = mesh.vertices, stored.skeleton()
    leaf = stored.tensors["part"] == LEAF
    piece = _first_of_piece(mesh)
    base = vertices[piece]
    arm = (vertices - base) * leaf[:, None]
    out = np.linalg.norm(arm, axis=1)
    length = np.zeros(len(vertices))
    np.maximum.at(length, piece, out)
    length = np.maximum(length[piece], SHORTEST_M)
    _, bone = cKDTree(skeleton.position).query(np.where(leaf[:, None], base, vertices))
    scale = ARM_SCALE / mesh.height_m
    columns = [
        leaf,
        out * scale,
        out / length * leaf,
        np.log(length) * leaf,
        skeleton.level[bone],
        np.log(skeleton.stem_length_m[skeleton.stem[bone]]),
        np.log(skeleton.radius[bone]),
        *(arm * scale).T,
    ]
    assert len(columns) == NUM_PARTS
    return np.stack(columns, axis=1).astype(np.float32)


def _first_of_piece(mesh: Surface) -> Int64[np.ndarray, " N"]:
    """Return the first vertex of each vertex's connected component; a leaf's first vertex is its base."""
    piece = connected_parts(mesh.faces, mesh.num_vertices)
    return np.asarray(np.unique(piece, return_index=True)[1][piece], np.int64)
