"""Detect ground and tables in points: a dense, wide and flat plane at the bottom."""

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Bool, Float64, Int64

from dynamictree.planes import Plane, Points, best_plane, fit_plane, planes_of_triples, support

UP = np.array([0.0, 0.0, 1.0])
_COLUMNS = 25  # number along the slab's longer side
_FEWEST = 30  # least number of columns or points


def find_ground(points: Points, height_m: float, rng: np.random.Generator) -> Plane | None:
    """Find a plane just above the ground, with its normal upward; None if there is no ground."""
    slab_share = 0.05  # share of the height, from the bottom, that is searched for ground
    tolerated, tolerated_if_narrow = 0.012, 0.04  # share of the height, and of a narrow slab's width
    steepest = np.cos(np.radians(20))
    trials = 200
    wide, wider = 0.3, 3.0  # narrower width [height], or [width of the standing object]
    below = 0.05  # largest share of columns with points below the plane
    slab = points[points[:, 2] < np.quantile(points[:, 2], 0.002) + slab_share * height_m]
    if len(slab) < _FEWEST:
        return None
    low, high = np.quantile(slab[:, :2], [0.01, 0.99], axis=0)
    width = float((high - low).max())
    if width <= 0:
        return None
    tolerance = min(tolerated * height_m, tolerated_if_narrow * width)
    cells = np.floor((points[:, :2] - low) / (width / _COLUMNS)).astype(np.int64)
    in_slab = ((cells >= 0) & (cells < _COLUMNS)).all(axis=1)
    columns, lowest = _lowest(points[in_slab], (cells[:, 0] * _COLUMNS + cells[:, 1])[in_slab])
    if len(columns) < _FEWEST:
        return None
    plane = best_plane(
        (one.facing(UP) for one in planes_of_triples(lowest, trials, rng)),
        lambda one: support(one.above(lowest), tolerance) if one.normal[2] > steepest else 0.0,
        0.0,
    )
    if plane is None:
        return None
    for _ in range(2):
        plane = fit_plane(lowest[np.abs(plane.above(lowest)) <= tolerance]).facing(UP)
    off, above = plane.above(lowest), plane.above(points)
    patch = _largest_patch(columns[np.abs(off) <= tolerance])
    if not _fills(patch) or (off < -2 * tolerance).sum() > below * len(off):
        return None
    side = width / _COLUMNS
    narrow = side * float(np.ptp(np.argwhere(patch), axis=0).min() + 1)
    standing = points[(above > 2 * tolerance) & (above < 2 * tolerance + slab_share * height_m)]
    if narrow < wide * height_m and narrow < wider * _width(standing):
        return None
    if not is_level(points[np.abs(above) <= tolerance], side, rng):
        return None
    return Plane(plane.normal, plane.offset + 1.5 * tolerance)


def _lowest(points: Points, key: Int64[np.ndarray, " P"]) -> tuple[Int64[np.ndarray, " C"], Float64[np.ndarray, "C 3"]]:
    """Return the lowest point of each column, without a few strays."""
    order = np.lexsort((points[:, 2], key))
    columns, start, count = np.unique(key[order], return_index=True, return_counts=True)
    return columns, points[order[start + np.minimum(count // 50 + (count > 5), count - 1)]]


def _largest_patch(columns: Int64[np.ndarray, " C"]) -> Bool[np.ndarray, "X Y"]:
    seen = np.zeros((_COLUMNS, _COLUMNS), np.bool_)
    seen[columns // _COLUMNS, columns % _COLUMNS] = True
    closed = scipy.ndimage.binary_closing(np.pad(seen, 2), np.ones((3, 3), np.bool_))[2:-2, 2:-2]
    pieces, _ = scipy.ndimage.label(closed | seen, np.ones((3, 3)))
    largest: Bool[np.ndarray, "X Y"] = seen & (pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:]))
    return largest


def _fills(patch: Bool[np.ndarray, "X Y"]) -> bool:
    filled = 0.6  # share of the columns in its outline
    places = np.argwhere(patch)
    if len(places) < _FEWEST:
        return False
    corners = (places[:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]).reshape(-1, 2)
    return bool(len(places) > filled * scipy.spatial.ConvexHull(corners).volume)


def _width(points: Points) -> float:
    if len(points) == 0:
        return 0.0
    low, high = np.quantile(points[:, :2], [0.02, 0.98], axis=0)
    return float((high - low).max())


def is_level(points: Points, reach: float, rng: np.random.Generator) -> bool:
    """Whether the surface through most of the points is locally level, unlike that of leaves and roots."""
    level_share = 0.5  # least share of neighbourhoods that are level
    if len(points) < _FEWEST:
        return False
    chosen = points[rng.choice(len(points), min(len(points), 500), replace=False)]  # few, to skip fine roughness
    near = np.asarray(
        scipy.spatial.cKDTree(chosen).query(chosen, k=min(12, len(chosen)), distance_upper_bound=2 * reach)[1]
    )
    enough = (near < len(chosen)).sum(axis=1) >= 5
    level = [abs(fit_plane(chosen[row[row < len(chosen)]]).normal[2]) for row in near[enough]]
    return bool(level and np.mean(np.array(level) > 0.85) >= level_share)
