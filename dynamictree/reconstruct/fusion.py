"""Fuse depth maps into a surface: truncated signed distance on a grid (Curless and Levoy 1996), then marching cubes."""

from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.ndimage import label, maximum_filter, minimum_filter
from skimage.measure import marching_cubes

from dynamictree.mesh import Surface, connected_parts
from dynamictree.parallel import compiled, in_bands
from dynamictree.reconstruct.stereo import StereoView

_TRUNCATION = 3.0  # [voxels] on each side of a surface
_CARVE_WEIGHT = 0.25  # weight of a view that looks through a voxel; 1 for one that sees a surface there


@dataclass(frozen=True, kw_only=True)
class Box:
    """Axis-aligned box that is meshed."""

    low: Float64[np.ndarray, "3"]
    high: Float64[np.ndarray, "3"]


class _Volume(NamedTuple):
    """Weighted sum of signed distances over views, and sum of the weights."""

    distance: Float32[np.ndarray, "X Y Z"]  # [truncation bands], positive outside
    weight: Float32[np.ndarray, "X Y Z"]
    low: Float64[np.ndarray, "3"]
    voxel: float


EMPTY_SURFACE = Surface(vertices=np.zeros((0, 3), np.float32), faces=np.zeros((0, 3), np.int32))


def fuse(views: list[StereoView], depths: list[Float32[np.ndarray, "H W"]], box: Box, *, resolution: int) -> Surface:
    """Mesh the surface in a box from depth maps, with `resolution` voxels along the longest side; it may be empty."""
    voxel = float((box.high - box.low).max()) / resolution
    size = np.maximum(np.ceil((box.high - box.low) / voxel).astype(int), 2)
    distance = np.zeros(tuple(size.tolist()), np.float32)
    weight = np.zeros_like(distance)
    volume = _Volume(distance, weight, box.low, voxel)
    for view, depth in zip(views, depths, strict=True):
        in_bands(_integrate, len(distance), volume, view.to_pixel, depth)
    observed = weight > 0
    distance = np.where(observed, distance / np.maximum(weight, 1e-9), 1)
    # a cell is meshed where all its corners are known; skimage names a cell by its highest corner
    whole = minimum_filter(observed, size=2, mode="constant", cval=0)
    crossed = minimum_filter(distance, size=2, mode="nearest") < 0
    if not (whole & crossed & (maximum_filter(distance, size=2, mode="nearest") > 0)).any():
        return EMPTY_SURFACE
    # "descent" turns faces outward where the inside is negative (skimage's text says the opposite; tested)
    vertices, faces, _, _ = marching_cubes(distance, 0.0, mask=whole, gradient_direction="descent")  # type: ignore[no-untyped-call]
    places = (box.low + (vertices + 0.5) * voxel).astype(np.float32)
    return Surface(vertices=places, faces=faces.astype(np.int32))


def main_cluster(surface: Surface, gap: float) -> Surface:
    """Return the largest group of pieces that are closer together than about `gap`, without specks.

    Leaves and twigs are seldom connected in a reconstructed mesh, but they are near one another.
    """
    speck_faces = 24  # faces; smaller pieces are noise
    if len(surface.faces) == 0:
        return surface
    piece_of_face = connected_parts(surface.faces, len(surface.vertices))[surface.faces[:, 0]]
    large = np.flatnonzero((np.bincount(piece_of_face) >= speck_faces)[piece_of_face])
    if len(large) == 0:
        return EMPTY_SURFACE
    centres = surface.vertices[surface.faces[large]].mean(axis=1)
    cells = ((centres - centres.min(axis=0)) / gap).astype(int)
    occupied = np.zeros(cells.max(axis=0) + 1, bool)
    occupied[tuple(cells.T)] = True
    group = label(occupied, structure=np.ones((3, 3, 3)))[0][tuple(cells.T)]
    return _with_faces(surface, large[group == np.bincount(group).argmax()])


def faces_above(surface: Surface, height: float) -> Surface:
    """Return the faces whose corners are all above a height."""
    return _with_faces(surface, np.flatnonzero((surface.vertices[surface.faces][:, :, 2] > height).all(axis=1)))


def _with_faces(surface: Surface, chosen: Int64[np.ndarray, " C"]) -> Surface:
    used, faces = np.unique(surface.faces[chosen], return_inverse=True)
    return Surface(vertices=surface.vertices[used], faces=faces.reshape(-1, 3).astype(np.int32))


@compiled
@no_type_check
def _integrate(first, end, volume, to_pixel, depth):
    """Add one view to slabs of the grid: positive before its surface, negative just behind it, unknown beyond."""
    distance, weight, low, voxel = volume
    _, size_y, size_z = distance.shape
    height, width = depth.shape
    band = _TRUNCATION * voxel
    for i in range(first, end):
        x = low[0] + (i + 0.5) * voxel
        for j in range(size_y):
            y = low[1] + (j + 0.5) * voxel
            u0 = to_pixel[0, 0] * x + to_pixel[0, 1] * y + to_pixel[0, 3]
            v0 = to_pixel[1, 0] * x + to_pixel[1, 1] * y + to_pixel[1, 3]
            w0 = to_pixel[2, 0] * x + to_pixel[2, 1] * y + to_pixel[2, 3]
            for k in range(size_z):
                z = low[2] + (k + 0.5) * voxel
                w = w0 + to_pixel[2, 2] * z
                if w <= 0:
                    continue
                column, row = (u0 + to_pixel[0, 2] * z) / w, (v0 + to_pixel[1, 2] * z) / w
                if not (0 <= column < width and 0 <= row < height):
                    continue
                seen = depth[int(row), int(column)]
                ahead = seen - w
                if seen == 0 or ahead < -band:
                    continue
                share = _CARVE_WEIGHT if ahead > band else 1.0
                distance[i, j, k] += share * min(ahead / band, 1.0)
                weight[i, j, k] += share
