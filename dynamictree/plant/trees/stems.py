"""Detect stems: compact, upright, separate clusters of cells on the ground.

As in forest inventories, stems are detected in slices near breast height: connected parts of a slice that are narrow,
extend through its thickness, and continue in a higher slice at nearly the same position. Tips of hanging branches are
thinner than the stem that bears them; boughs of conifers are wide or lean.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from dynamictree.plant.still import groups_of_cells

SLICE = (0.03, 0.10)
"""Slice in which stems are detected [share of the height above the ground]: 0.6 to 2 m of a tree of 20 m."""
HIGHER = (0.10, 0.17)
UPRIGHT = 0.03
"""Largest shift of a stem from the slice to the higher one [share of the height]."""
NEAREST = 0.04
"""Distance below which stems belong to one tree [share of the height]."""


@dataclass(frozen=True, kw_only=True)
class Stem:
    """Stem of a tree [cells]."""

    cells: Int64[np.ndarray, " M"]  # rows of the cells in the slice
    middle: Float64[np.ndarray, "2"]
    higher: Float64[np.ndarray, "2"]  # middle in the higher slice
    radius: float


def find_stems(
    coords: Int64[np.ndarray, "V 3"], above: Float64[np.ndarray, " V"], rows: Int64[np.ndarray, " M"]
) -> list[Stem]:
    """Detect stems among some cells, relative to the cells' largest height; join stems of one tree."""
    thinnest = 0.3  # share of the largest stem's cells; thinner ones are twigs that hang to the ground
    bare = 0.67  # least share of a slice's cells in stems; then no branches hang into it
    tall = float(above[rows].max()) + 1
    stems = _upright_stems(coords, above, rows, tall)
    if not stems:  # crowns that start in the higher slice hide stems; try slices at half the height
        stems = _upright_stems(coords, 2 * above, rows, tall)
        inside = (2 * above[rows] >= SLICE[0] * tall) & (2 * above[rows] < SLICE[1] * tall)
        stems = stems if sum(len(stem.cells) for stem in stems) >= bare * inside.sum() else []
    most = max((len(stem.cells) for stem in stems), default=0)
    return join_stems([stem for stem in stems if len(stem.cells) >= thinnest * most], tall)


def _upright_stems(
    coords: Int64[np.ndarray, "V 3"], above: Float64[np.ndarray, " V"], rows: Int64[np.ndarray, " M"], tall: float
) -> list[Stem]:
    """Return the columns of the slice that continue in the higher one."""
    upper = _columns(coords, above, rows, tall, HIGHER)
    stems = []
    for column in _columns(coords, above, rows, tall, SLICE) if upper else ():
        nearest = min(upper, key=lambda other: float(np.linalg.norm(other.middle - column.middle)))
        if np.linalg.norm(nearest.middle - column.middle) < UPRIGHT * tall:
            stems.append(replace(column, higher=nearest.middle))
    return stems


def _columns(
    coords: Int64[np.ndarray, "V 3"],
    above: Float64[np.ndarray, " V"],
    rows: Int64[np.ndarray, " M"],
    tall: float,
    between: tuple[float, float],
) -> list[Stem]:
    """Find narrow, separate parts of a slice that extend through its thickness."""
    narrow = 0.07  # share of the height; largest radius of a stem
    through_share = 0.8  # share of the slice's thickness
    alone = 0.5  # least share, in the stem, of the cells within three radii
    low, high = between[0] * tall, between[1] * tall
    inside = rows[(above[rows] >= low) & (above[rows] < high)]
    if len(inside) == 0:
        return []
    part = groups_of_cells(coords[inside])
    columns = []
    for one in np.flatnonzero(np.bincount(part) >= through_share * (high - low)):
        cells = inside[part == one]
        middle = np.median(coords[cells, :2], axis=0)
        away = np.linalg.norm(coords[inside, :2] - middle, axis=1)
        radius = float(np.median(away[part == one]))
        own = 1.5 * radius + 1
        is_alone = (away < own).sum() >= alone * (away < 3 * own).sum()
        through = np.ptp(above[cells]) + 1 >= through_share * (high - low)
        if through and radius <= narrow * tall and is_alone:
            columns.append(Stem(cells=cells, middle=middle, higher=middle, radius=max(radius, 0.5)))
    return columns


def join_stems(stems: list[Stem], tall: float) -> list[Stem]:
    """Join stems that are close, or moderately close and diverging; `tall` is in cells."""
    fork = 0.15  # share of the height, within which diverging stems are one tree
    apart_higher = 1.15  # least ratio of distances in the higher slice and the slice for diverging stems
    group = list(range(len(stems)))
    for i, one in enumerate(stems):
        for j in range(i):
            other = stems[j]
            near = float(np.linalg.norm(one.middle - other.middle))
            forked = float(np.linalg.norm(one.higher - other.higher)) > apart_higher * near
            if near < NEAREST * tall or (near < fork * tall and forked):
                group = [group[j] if number == group[i] else number for number in group]
    joined = []
    for number in sorted(set(group)):
        members = [stem for stem, own in zip(stems, group, strict=True) if own == number]
        thickest = max(members, key=lambda stem: len(stem.cells))
        joined.append(replace(thickest, cells=np.concatenate([stem.cells for stem in members])))
    return joined
