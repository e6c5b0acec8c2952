"""Occupied cells of a point cloud, with their height above the ground and the graph of neighbours."""

from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Bool, Float64, Int64

from dynamictree.voxel.graph import neighbour_pairs

CELLS_TALL = 200
"""Cells in the height of the tallest tree: 0.1 m for 20 m, so that a stem is two to four cells wide."""
_TILE = 5  # [cells], side of the tiles on which the ground's height is estimated


@dataclass(frozen=True, kw_only=True)
class OccupiedCells:
    """Cells that contain points, in ascending order of x, y, z."""

    coords: Int64[np.ndarray, "V 3"]
    above: Float64[np.ndarray, " V"]  # height above the ground nearby [cells]
    ground: Bool[np.ndarray, " V"]  # cells of ground, not plant
    afloat: Bool[np.ndarray, " V"]  # cells over a crown's edge instead of ground
    size_m: float  # side of a cell
    low_m: Float64[np.ndarray, "3"]  # low corner of cell (0, 0, 0)
    cell_of_point: Int64[np.ndarray, " P"]

    @property
    def centres_m(self) -> Float64[np.ndarray, "V 3"]:
        """Centre of each cell [m]."""
        return self.low_m + (self.coords + 0.5) * self.size_m


def occupied_cells(points: Float64[np.ndarray, "P 3"], *, is_scan: bool = False) -> OccupiedCells:
    """Put points [m, +Z up] into cells."""
    max_cells_along = 1500
    steepest, unseen = 1.0, 0.3  # largest slope of the ground, and of one that no point shows, other than in scans
    afloat = 0.1  # share of the height; tiles this much above such ground have no ground
    ground_cover = 0.4  # least share of occupied tiles with low cells for ground to exist
    low = points.min(axis=0)
    extent = points.max(axis=0) - low
    size = max(float(extent[2]) / CELLS_TALL, float(extent.max()) / max_cells_along)
    coords = np.floor((points - low) / size).astype(np.int64)
    span = coords.max(axis=0) + 1
    keys, cell = np.unique((coords[:, 0] * span[1] + coords[:, 1]) * span[2] + coords[:, 2], return_inverse=True)
    coords = np.stack([keys // (span[1] * span[2]), keys // span[2] % span[1], keys % span[2]], axis=1)
    tall = int(span[2])
    lowest, tile = _lowest_near(coords, tall)
    plane = np.stack([*np.indices(lowest.shape), np.ones(lowest.shape)], axis=-1).reshape(-1, 3)
    slope = np.linalg.lstsq(plane, lowest.ravel(), rcond=None)[0][:2]
    downhill = float(np.abs(slope).sum()) * _reach(tall)  # middle of a window over its lowest point
    above, low_cells, cover = _above(coords, tile, lowest + downhill)
    if cover < ground_cover:  # no ground from which to measure a slope, and leaves droop where there is none
        above, low_cells, cover = _above(coords, tile, lowest if is_scan else _no_steeper(lowest, unseen * _TILE))
    return OccupiedCells(
        coords=coords,
        above=above,
        ground=low_cells & (cover >= ground_cover),
        afloat=(lowest - _no_steeper(lowest, steepest * _TILE) > afloat * tall)[tile],
        size_m=size,
        low_m=low,
        cell_of_point=cell.ravel().astype(np.int64),
    )


def _lowest_near(
    coords: Int64[np.ndarray, "V 3"], tall: int
) -> tuple[Float64[np.ndarray, "X Y"], tuple[Int64[np.ndarray, " V"], Int64[np.ndarray, " V"]]]:
    """Return the height of the lowest cell around each tile, and each cell's tile."""
    tile = coords[:, 0] // _TILE, coords[:, 1] // _TILE
    lowest = np.full((int(tile[0].max()) + 1, int(tile[1].max()) + 1), np.inf)
    np.minimum.at(lowest, tile, coords[:, 2])
    near = scipy.ndimage.minimum_filter(lowest, size=2 * _reach(tall) + 1, mode="nearest")
    near[~np.isfinite(near)] = near[np.isfinite(near)].min()
    smooth: Float64[np.ndarray, "X Y"] = scipy.ndimage.uniform_filter(near, size=2 * _reach(tall) + 1, mode="nearest")
    return smooth, tile


def _no_steeper(lowest: Float64[np.ndarray, "X Y"], rise: float) -> Float64[np.ndarray, "X Y"]:
    """Return the highest surface below a given one whose rise per tile, also diagonally, is limited."""
    across = np.hypot(*np.meshgrid((-1, 0, 1), (-1, 0, 1)))
    while True:
        lower = scipy.ndimage.grey_erosion(lowest, structure=-rise * across, mode="nearest")
        if np.array_equal(lower, lowest):
            return lowest
        lowest = lower


def _reach(tall: int) -> int:
    window = 1 / 6  # share of the height; the lowest point in this window is on the ground
    return max(1, round(window * tall / _TILE))


def _above(
    coords: Int64[np.ndarray, "V 3"],
    tile: tuple[Int64[np.ndarray, " V"], Int64[np.ndarray, " V"]],
    ground: Float64[np.ndarray, "X Y"],
) -> tuple[Float64[np.ndarray, " V"], Bool[np.ndarray, " V"], float]:
    """Return the height above the ground [cells], a mask of low cells, and the share of tiles with any."""
    ground_share = 0.02  # share of the height; lower cells are ground, if there is ground
    above = coords[:, 2] - ground[tile]
    low = above < ground_share * (coords[:, 2].max() + 1)
    occupied, covered = np.zeros((2, *ground.shape), np.bool_)
    occupied[tile], covered[tile[0][low], tile[1][low]] = True, True
    return above, low, covered.sum() / occupied.sum()


def cell_graph(coords: Int64[np.ndarray, "V 3"]) -> "scipy.sparse.csr_array":
    """Build a graph of near cells; edges are squared distances [cells²], so gaps cost more than detours.

    The cells are in ascending order of x, y, z; a pair has one edge, if one is among the nearest of the other.
    """
    neighbours = 12
    gap = 2.5  # [cells], largest distance of connected cells
    along = range(-int(gap), int(gap) + 1)
    near = [offset for offset in product(along, along, along) if offset > (0, 0, 0) and _squared(offset) <= gap**2]
    near.sort(key=_squared)
    count = np.zeros(len(coords), np.int64)  # number of nearer cells around each
    starts, ends, costs = [], [], []
    for offset, (start, end) in zip(near, neighbour_pairs(coords, near), strict=True):
        among_nearest = count[start] < neighbours
        count[start] += 1
        among_nearest |= count[end] < neighbours
        count[end] += 1
        starts.append(start[among_nearest])
        ends.append(end[among_nearest])
        costs.append(np.full(int(among_nearest.sum()), float(_squared(offset))))
    places = np.concatenate(starts), np.concatenate(ends)
    return scipy.sparse.coo_array((np.concatenate(costs), places), shape=(len(coords),) * 2).tocsr()


def _squared(offset: tuple[int, int, int]) -> int:
    return sum(along * along for along in offset)
