"""Sparse voxel grid, on which a tree's motion is defined."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, Int64

from dynamictree.errors import InputError

MARGIN = 0.01
"""Empty border of the grid's cube, which encloses the whole surface [share of the largest extent]."""


@dataclass(frozen=True, kw_only=True)
class VoxelGrid:
    """Occupied voxels in a cube of `resolution`³ voxels, in ascending order of `keys`.

    The centre of a voxel is `origin_m + (coords + 0.5) * voxel_size_m`.
    """

    coords: Int32[np.ndarray, "V 3"]
    origin_m: tuple[float, float, float]  # low corner of the cube [m]
    voxel_size_m: float
    resolution: int

    def __post_init__(self) -> None:
        if len(self.coords) == 0:
            raise InputError("the voxel grid is empty; at least one occupied voxel is needed")
        if self.coords.min() < 0 or self.coords.max() >= self.resolution:
            low, high = int(self.coords.min()), int(self.coords.max())
            raise InputError(f"voxel indices run from {low} to {high}; the grid allows 0 to {self.resolution - 1}")
        if not (np.isfinite(self.voxel_size_m) and self.voxel_size_m > 0):
            raise InputError(f"voxel_size_m is {self.voxel_size_m}; it must be positive and finite")
        if (np.diff(self.keys) <= 0).any():
            raise InputError("voxels must be unique and in ascending order of x, y, z; make the grid with from_coords")

    @classmethod
    def from_coords(
        cls,
        coords: Int32[np.ndarray, "M 3"],
        *,
        origin_m: tuple[float, float, float],
        voxel_size_m: float,
        resolution: int,
    ) -> "VoxelGrid":
        """Create a grid from coordinates in any order, with duplicates removed."""
        keys = unique_keys(_keys(coords, resolution))
        ordered = np.stack([keys // resolution**2, keys // resolution % resolution, keys % resolution], axis=1)
        return cls(coords=ordered.astype(np.int32), origin_m=origin_m, voxel_size_m=voxel_size_m, resolution=resolution)

    def __len__(self) -> int:
        return len(self.coords)

    @property
    def keys(self) -> Int64[np.ndarray, " V"]:
        """One ascending integer per voxel: (x R + y) R + z."""
        return _keys(self.coords, self.resolution)

    @property
    def centres_m(self) -> Float32[np.ndarray, "V 3"]:
        """Voxel centres [m]."""
        return (np.asarray(self.origin_m) + (self.coords + 0.5) * self.voxel_size_m).astype(np.float32)

    @property
    def height_m(self) -> float:
        """Height from the bottom of the lowest voxel to the top of the highest [m]."""
        return (int(np.ptp(self.coords[:, 2])) + 1) * self.voxel_size_m

    def coords_of(self, points: Float32[np.ndarray, "N 3"]) -> Int32[np.ndarray, "N 3"]:
        """Return the index of the voxel at each point, which may be empty or outside the cube."""
        return np.asarray(np.floor((points - np.asarray(self.origin_m)) / self.voxel_size_m), np.int32)

    def rows_of(self, coords: Int32[np.ndarray, "N 3"]) -> Int32[np.ndarray, " N"]:
        """Return the row in `coords` of each voxel index, or -1 if the voxel is not occupied."""
        inside = ((coords >= 0) & (coords < self.resolution)).all(axis=1)
        wanted = _keys(coords, self.resolution)
        keys = self.keys
        rows = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where(inside & (keys[rows] == wanted), rows, -1).astype(np.int32)


def grid_frame(points: Float32[np.ndarray, "N 3"], resolution: int) -> tuple[tuple[float, float, float], float]:
    """Return origin and voxel size [m] of a cube around all points; grids of 2ⁿ times the resolution nest exactly.

    The cube is centred horizontally; its floor is just below the lowest point.
    """
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    extent = float((high - low).max())
    side = extent * (1 + 2 * MARGIN)
    origin = (low + high - side) / 2
    origin[2] = low[2] - MARGIN * extent
    return (float(origin[0]), float(origin[1]), float(origin[2])), side / resolution


def unique_keys(keys: Int64[np.ndarray, " M"]) -> Int64[np.ndarray, " D"]:
    """Return unique keys in ascending order; for millions of keys 40 times as fast as `np.unique`."""
    ordered = np.sort(keys)
    first: Int64[np.ndarray, " D"] = ordered[np.flatnonzero(np.diff(ordered, prepend=ordered[:1] - 1))]
    return first


def morton_order(cells: Int64[np.ndarray, "M 3"]) -> Int64[np.ndarray, " M"]:
    """Sort cells with coordinates below 65,536 along a Morton curve."""
    key = np.zeros(len(cells), np.int64)
    for bit in range(16):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << 3 * bit + axis
    return np.argsort(key, kind="stable")


def _keys(coords: Int32[np.ndarray, "M 3"], resolution: int) -> Int64[np.ndarray, " M"]:
    x, y, z = coords.astype(np.int64).T
    keys: Int64[np.ndarray, " M"] = (x * resolution + y) * resolution + z
    return keys
