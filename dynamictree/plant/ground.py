"""Ground and tables in a cloud: a plane at the bottom that is filled, wide and flat."""

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Bool, Float64, Int64

Points = Float64[np.ndarray, "_ 3"]

_SLAB = 0.05  # of the height: the ground is looked for from the bottom up to here
_COLUMNS = 25  # of the slab, along its longer side
_TOLERANCE = 0.012  # of the height
_NARROW_TOLERANCE = 0.04  # of the slab's width, where it is narrow
_STEEPEST = 0.36  # slope of the ground: 20°
_TRIALS = 200
_WIDE = 0.3  # of the height: the ground's narrower width
_WIDER = 3.0  # or this much of the width of what stands on it
_FILLED = 0.6  # of the columns in its outline
_BELOW = 0.05  # of them at most, may have something below the plane
_LEVEL = 0.5  # of its places at least, are flat in themselves
_FEWEST = 30  # columns


def find_ground(points: Points, height_m: float, rng: np.random.Generator) -> Float64[np.ndarray, "3"] | None:
    """Slopes along x and y, and height where both are 0, of a plane above the ground; None where none is to be seen."""
    bottom = np.quantile(points[:, 2], 0.002)
    slab = points[points[:, 2] < bottom + _SLAB * height_m]
    if len(slab) < _FEWEST:
        return None
    low, high = np.quantile(slab[:, :2], [0.01, 0.99], axis=0)
    width = float((high - low).max())
    if width <= 0:
        return None
    tolerance = min(_TOLERANCE * height_m, _NARROW_TOLERANCE * width)
    cells = np.floor((points[:, :2] - low) / (width / _COLUMNS)).astype(np.int64)
    in_slab = ((cells >= 0) & (cells < _COLUMNS)).all(axis=1)
    key = cells[:, 0] * _COLUMNS + cells[:, 1]
    columns, lowest = _lowest(points[in_slab], key[in_slab])
    if len(columns) < _FEWEST:
        return None
    plane = _fit_plane(lowest, tolerance, rng)
    if plane is None:
        return None
    off = lowest[:, 2] - lowest[:, :2] @ plane[:2] - plane[2]
    above = points[:, 2] - points[:, :2] @ plane[:2] - plane[2]
    on = np.abs(off) <= tolerance
    patch = _largest_patch(columns[on])
    if not _fills(patch) or (off < -2 * tolerance).sum() > _BELOW * len(off):
        return None
    side = width / _COLUMNS
    narrow = side * float(np.ptp(np.argwhere(patch), axis=0).min() + 1)
    standing = points[(above > 2 * tolerance) & (above < 2 * tolerance + _SLAB * height_m)]
    if narrow < _WIDE * height_m and narrow < _WIDER * _width(standing):
        return None
    near = np.abs(above) <= tolerance
    if not is_level(points[near], side, rng):
        return None
    return np.array([plane[0], plane[1], plane[2] + 1.5 * tolerance])


def _lowest(points: Points, key: Int64[np.ndarray, " P"]) -> tuple[Int64[np.ndarray, " C"], Float64[np.ndarray, "C 3"]]:
    """The lowest point of each column, but for a few strays."""
    order = np.lexsort((points[:, 2], key))
    columns, start, count = np.unique(key[order], return_index=True, return_counts=True)
    return columns, points[order[start + np.minimum(count // 50 + (count > 5), count - 1)]]


def _fit_plane(
    lowest: Float64[np.ndarray, "C 3"], tolerance: float, rng: np.random.Generator
) -> Float64[np.ndarray, "3"] | None:
    """Slopes and height of the plane that most of the places lie on and few below."""
    best, best_score = None, 0.0
    terms = np.column_stack([lowest[:, :2], np.ones(len(lowest))])
    for _ in range(_TRIALS):
        three = rng.choice(len(lowest), 3, replace=False)
        if abs(np.linalg.det(terms[three])) < 1e-12:
            continue
        plane = np.linalg.solve(terms[three], lowest[three, 2])
        if np.hypot(*plane[:2]) > _STEEPEST:
            continue
        off = lowest[:, 2] - terms @ plane
        score = (np.abs(off) <= tolerance).sum() - 2.0 * (off < -tolerance).sum()
        if score > best_score:
            best, best_score = plane, score
    for _ in range(2 if best is not None else 0):
        on = np.abs(lowest[:, 2] - terms @ best) <= tolerance
        best = np.linalg.lstsq(terms[on], lowest[on, 2], rcond=None)[0]
    return best


def _largest_patch(columns: Int64[np.ndarray, " C"]) -> Bool[np.ndarray, "X Y"]:
    seen = np.zeros((_COLUMNS, _COLUMNS), np.bool_)
    seen[columns // _COLUMNS, columns % _COLUMNS] = True
    closed = scipy.ndimage.binary_closing(np.pad(seen, 2), np.ones((3, 3), np.bool_))[2:-2, 2:-2]
    pieces, count = scipy.ndimage.label(closed | seen, np.ones((3, 3)))
    if count == 0:
        return seen
    largest: Bool[np.ndarray, "X Y"] = seen & (pieces == 1 + np.argmax(np.bincount(pieces.ravel())[1:]))
    return largest


def _fills(patch: Bool[np.ndarray, "X Y"]) -> bool:
    places = np.argwhere(patch)
    if len(places) < _FEWEST:
        return False
    corners = (places[:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]).reshape(-1, 2)
    try:
        return bool(len(places) > _FILLED * scipy.spatial.ConvexHull(corners).volume)
    except scipy.spatial.QhullError:
        return False


def _width(points: Points) -> float:
    if len(points) == 0:
        return 0.0
    low, high = np.quantile(points[:, :2], [0.02, 0.98], axis=0)
    return float((high - low).max())


def is_level(points: Points, reach: float, rng: np.random.Generator) -> bool:
    """Whether the surface through most of the points is level, as that of leaves and roots is not."""
    if len(points) < _FEWEST:
        return False
    chosen = points[rng.choice(len(points), min(len(points), 500), replace=False)]  # so few that grains even out
    near = np.asarray(
        scipy.spatial.cKDTree(chosen).query(chosen, k=min(12, len(chosen)), distance_upper_bound=2 * reach)[1]
    )
    enough = (near < len(chosen)).sum(axis=1) >= 5
    if not enough.any():
        return False
    level = [_normal(chosen[row[row < len(chosen)]])[2] for row in near[enough]]
    return bool((np.abs(level) > 0.85).mean() >= _LEVEL)


def _normal(points: Points) -> Float64[np.ndarray, "3"]:
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1])
