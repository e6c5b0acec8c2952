"""Detect the parts of a splat or scan that are not the plant and stand still: ground, tables, pots, things, floaters.

Each is taken only where its shape leaves no doubt; what is not found can be named with a box or a mask.
"""

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Bool, Float64, Int32, Int64, UInt8

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import StillPart
from dynamictree.plant.ground import Points, find_ground
from dynamictree.plant.pot import find_pot, in_pot

_SOLID = 0.05  # opacity
_LARGE = 0.1  # of the extent: Gaussians of the background
_MOST_POINTS = 200_000
_FEWEST_POINTS = 500
_STRAYS = 0.002
_CELL = 0.03  # of the height
_APART = 0.06  # of the height: what is so far from the plant does not hang on it
_LOW = 0.2  # of the height: so high things beside it reach
_SMALL = 0.2  # of the points: all that lies apart
_FEW = 0.02  # of the points: floaters
_LEAST_PLANT = 0.02  # of the points: with fewer left over, nothing is taken away


GROUND = StillPart(name="ground", why="a level plane at the bottom, wider than what stands on it")
POT = StillPart(name="pot", why="a closed wall at the bottom, filled with soil")
THINGS = StillPart(name="things", why="low on the ground, and apart from the plant")
FLOATERS = StillPart(name="floaters", why="a few Gaussians far from all others")


def find_still_gaussians(cloud: GaussianCloud) -> tuple[tuple[StillPart, ...], UInt8[np.ndarray, " G"]]:
    """The parts of a cloud in metres and +Z up that stand still, and of each Gaussian its part from 1, or 0."""
    part_of = np.zeros(cloud.num_gaussians, np.uint8)
    parts: list[StillPart] = []

    def take(part: StillPart, rows: Bool[np.ndarray, " G"]) -> None:
        rows = rows & (part_of == 0)
        left = solid & (part_of == 0) & ~rows
        if rows.any() and left.sum() >= max(_LEAST_PLANT * solid.sum(), _FEWEST_POINTS / 10):
            if part not in parts:
                parts.append(part)
            part_of[rows] = 1 + parts.index(part)

    means = cloud.means.astype(np.float64)
    solid = (cloud.opacity >= _SOLID) & (cloud.scales.max(axis=1) <= _LARGE * np.ptp(means, axis=0).max())
    if solid.sum() < _FEWEST_POINTS:
        return (), part_of
    rng = np.random.default_rng(0)
    for _ in range(2):  # a floor, and a table on it
        points = _thinned(means[solid & (part_of == 0)])
        plane = find_ground(points, height_of(points), rng)
        if plane is None:
            break
        take(GROUND, means @ np.array([-plane[0], -plane[1], 1.0]) <= plane[2])
    height_m = height_of(means[solid & (part_of == 0)])
    if not height_m > 0:
        return tuple(parts), part_of
    apart = _apart(means, solid & (part_of == 0), height_m)
    if GROUND in parts:
        take(THINGS, apart[THINGS])
    take(FLOATERS, apart[FLOATERS])
    pot = find_pot(_thinned(means[solid & (part_of == 0)]), height_m, rng)
    if pot is not None:
        take(POT, in_pot(pot, means))
    return tuple(parts), part_of


def _thinned(points: Points) -> Points:
    return points[:: -(-len(points) // _MOST_POINTS)]


def height_of(points: Points) -> float:
    """Extent along +Z without strays [m]."""
    low, high = np.quantile(points[:, 2], [_STRAYS, 1 - _STRAYS])
    return float(high - low)


def _apart(
    means: Float64[np.ndarray, "G 3"], solid: Bool[np.ndarray, " G"], height_m: float
) -> dict[StillPart, Bool[np.ndarray, " G"]]:
    """What lies low and apart from the largest group of the solid Gaussians, and few Gaussians far from it."""
    cells, cell, count, group = touching_groups(means[solid], _CELL * height_m)
    number = int(group.max()) + 1
    size = np.bincount(group, count, minlength=number)
    main = int(size.argmax())
    distance = scipy.spatial.cKDTree(cells[group == main]).query(cells)[0] - 1.0  # at least, in cells
    gap, top = np.full(number, np.inf), np.full(number, -np.inf)
    np.minimum.at(gap, group, distance * _CELL)
    np.maximum.at(top, group, cells[:, 2] * _CELL)
    apart = gap > _APART
    low = apart & (top < cells[group == main, 2].min() * _CELL + _LOW)
    few = apart & ~low & (size < _FEW * size.sum())
    result = {}
    for part, groups in ((THINGS, low), (FLOATERS, few)):
        rows = np.zeros(len(means), np.bool_)
        if size[groups].sum() <= _SMALL * size.sum():
            rows[solid] = groups[group][cell]
        result[part] = rows
    return result


def touching_groups(
    points: Points, side_m: float
) -> tuple[Int64[np.ndarray, "C 3"], Int64[np.ndarray, " P"], Int64[np.ndarray, " C"], Int32[np.ndarray, " C"]]:
    """Filled cells of a grid, the cell of each point, their numbers of points, and their groups of cells that touch."""
    places = np.floor(points / side_m).astype(np.int64)
    first, span = places.min(axis=0), np.ptp(places, axis=0) + 1
    keys, cell, count = np.unique(
        ((places - first) * [span[1] * span[2], span[2], 1]).sum(axis=1), return_inverse=True, return_counts=True
    )
    cells = np.stack([keys // (span[1] * span[2]), keys // span[2] % span[1], keys % span[2]], axis=1)
    pairs = scipy.spatial.cKDTree(cells).query_pairs(1.8, output_type="ndarray")  # at corners as well
    joined = scipy.sparse.coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cells),) * 2)
    return cells, cell.ravel(), count, scipy.sparse.csgraph.connected_components(joined, directed=False)[1]
