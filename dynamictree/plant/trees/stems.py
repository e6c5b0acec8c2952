"""Find stems: compact, upright, separate clusters of cells on the ground.

Stems are looked for as forest inventories do, in slices near breast height: connected parts of a slice that are
narrow, go through it from below to above, and go on in the slices above it at nearly the same place. The tips of
hanging branches are thin beside the stem that bears them, the boughs of conifers are wide or lean.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from dynamictree.plant.still import groups_of_cells

SLICE = (0.03, 0.10)
"""Of the height above the ground: where stems are looked for, and 1 to 2 m of a tree of 20 m."""
HIGHER = (0.10, 0.17)
UPRIGHT = 0.03
"""Of the height: how far a stem leans from the slice to the higher one."""
NEAREST = 0.04
"""Of the height: stems that stand closer are of one tree."""


@dataclass(frozen=True, kw_only=True)
class Stem:
    """One stem, in cells."""

    cells: Int64[np.ndarray, " M"]  # rows of the cells in the slice
    middle: Float64[np.ndarray, "2"]
    higher: Float64[np.ndarray, "2"]  # its middle in the higher slice
    radius: float


def find_stems(
    coords: Int64[np.ndarray, "V 3"], above: Float64[np.ndarray, " V"], rows: Int64[np.ndarray, " M"]
) -> list[Stem]:
    """The stems among some cells, whose height is their own tallest; stems of one tree are joined."""
    thinnest = 0.3  # of the cells of the most massive stem: thinner ones are twigs that hang to the ground
    bare = 0.67  # of the cells of a slice in stems, at least: then no branches hang into it
    tall = float(above[rows].max()) + 1
    stems = _upright_stems(coords, above, rows, tall)
    if not stems:  # crowns that begin in the higher slice hide them, at half the height they may be bare
        stems = _upright_stems(coords, 2 * above, rows, tall)
        inside = (2 * above[rows] >= SLICE[0] * tall) & (2 * above[rows] < SLICE[1] * tall)
        stems = stems if sum(len(stem.cells) for stem in stems) >= bare * inside.sum() else []
    most = max((len(stem.cells) for stem in stems), default=0)
    return join_stems([stem for stem in stems if len(stem.cells) >= thinnest * most], tall)


def _upright_stems(
    coords: Int64[np.ndarray, "V 3"], above: Float64[np.ndarray, " V"], rows: Int64[np.ndarray, " M"], tall: float
) -> list[Stem]:
    """The columns of the slice that go on in the higher one."""
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
    """Narrow parts of a slice that go through it and stand apart."""
    narrow = 0.07  # of the height: the largest radius of a stem
    through_share = 0.8  # of the slice's thickness
    alone = 0.5  # of the cells within three radii, in the stem itself
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
    """Stems that stand close, or close enough and lean apart, as one; `tall` in cells."""
    fork = 0.15  # of the height: stems that stand so close and lean apart are of one tree
    apart_higher = 1.15  # times their distance in the slice, in the higher slice: they grow from one foot
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
