"""Detect pots in a cloud: a closed wall from the bottom up, filled with soil, from which something narrower rises."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Int64

from dynamictree.planes import Points
from dynamictree.plant.ground import is_level

Wall = tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, " S"]]
"""Axis, and the wall's distance from it in each sector [m]."""

_SECTORS = 24
_WALLED = 0.6  # least share of the sectors, and of the slices below the soil
_INSIDE = 0.8  # share of the outline, within which soil is visible
_SOIL = 0.85  # least share of the cells inside that soil fills


@dataclass(frozen=True, kw_only=True)
class Pot:
    """Position and shape of a pot [m]."""

    axis: Float64[np.ndarray, "2"]
    outline: Float64[np.ndarray, " S"]  # distance of the wall in each sector
    low: float
    soil: float
    rim: float


def find_pot(
    points: Points,
    height_m: float,
    rng: np.random.Generator,
    *,
    soil_seen: float = _SOIL,
    rise: Float64[np.ndarray, " P"] | None = None,
) -> Pot | None:
    """Find the pot at the bottom of the points; None if there is none for certain.

    A trunk is a closed wall as well, but no level surface fills it. `soil_seen` is the share of a pot's inside where
    soil must be visible. With the vertical components of normals (`rise`), soil must face up, and walls be steep.
    """
    strays = 0.002  # share of the points, at the bottom
    slices = 60  # number in the height
    highest = 0.6  # share of the height; the soil is lower
    least_slices = 4  # number with a wall below the soil
    least_radius = 0.04, 0.25  # share of the height, and of the soil's; a trunk is slenderer
    narrowest = 0.4  # share of the outline; a stem below a crown is narrower
    goes_on_from = 0.5  # share of the outline; least radius of a trunk that goes on above what looks like soil
    fewest_of_soil = 30  # [points]; at least 44 cells are inside, and soil fills 0.7 of them or more
    few_narrow = 0.2  # share of the slices that may be narrower
    level, steep = 0.5, 0.7  # least rise of soil, and largest of walls
    low = float(np.quantile(points[:, 2], strays))
    side = height_m / slices
    order = np.argsort(points[:, 2])
    ends = np.searchsorted(points[order, 2], low + side * np.arange(int(slices * highest) + 1))
    cuts = [order[a:b] for a, b in pairwise(ends)]
    rows = [points[cut] for cut in cuts]
    layers = rows if rise is None else [points[cut[rise[cut] > level]] for cut in cuts]
    sides = rows if rise is None else [points[cut[np.abs(rise[cut]) < steep]] for cut in cuts]
    walls: list[Wall | None] = []
    for soil in range(least_slices, len(rows) - 1):
        if sum(map(len, layers[soil : soil + 2])) < fewest_of_soil:
            continue
        walls += [_wall(row) for row in sides[len(walls) : soil]]
        below = [wall for wall in walls if wall is not None]
        if len(below) + len(rows) - soil < _WALLED * len(rows):
            return None  # too few, even if all slices above had walls
        if len(below) < max(least_slices, _WALLED * soil):
            continue
        wall = _joined(below)
        radius = float(np.median(wall[1]))
        lower = float(np.quantile([np.median(outline) for _, outline in below], few_narrow))
        if radius < max(least_radius[0] * height_m, least_radius[1] * soil * side) or lower < narrowest * radius:
            continue
        if _filled(np.concatenate(layers[soil : soil + 2]), wall) < soil_seen:
            continue
        top = _top_of_soil(rows, soil, wall)
        if top is None:
            continue
        layer = np.concatenate(layers[soil:top])
        away, sector = _polar(layer, wall[0])
        if not is_level(layer[away < _INSIDE * wall[1][sector]], radius / 4, rng):
            continue
        walls += [_wall(row) for row in sides[soil:]]
        goes_on = [
            one is not None and float(np.median(one[1])) > goes_on_from * radius for one in walls[top : top + soil]
        ]
        if np.mean(goes_on) > _WALLED:
            return None
        rim = top
        while rim < len(rows) and _continues(walls[rim], wall):
            rim += 1
        axis, outline = _joined(below + [one for one in walls[soil:rim] if one is not None and _continues(one, wall)])
        return Pot(axis=axis, outline=outline, low=low, soil=low + top * side, rim=low + rim * side)
    return None


def axis_of_pot(points: Points, pot: Pot) -> Float64[np.ndarray, "3"] | None:
    """Fit the pot's upward axis to the centres of its walls (Theil 1950, Sen 1968); None if there are too few."""
    slices_of_axis, least_of_axis = 6, 3  # number from the bottom to the soil, and with a wall
    ends = np.linspace(pot.low, pot.soil, slices_of_axis + 1)
    sides = [_wall(points[(points[:, 2] >= a) & (points[:, 2] < b)]) for a, b in pairwise(ends)]
    middles = np.array([[*side[0], (a + b) / 2] for side, (a, b) in zip(sides, pairwise(ends), strict=True) if side])
    if len(middles) < least_of_axis:
        return None
    one, other = np.triu_indices(len(middles), 1)
    way = middles[other] - middles[one]
    along = np.array([*np.median(way[:, :2] / way[:, 2:], axis=0), 1.0])
    return np.asarray(along / np.linalg.norm(along))


def in_pot(pot: Pot, points: Points) -> Bool[np.ndarray, " P"]:
    """Select the points of a pot: below the top of its soil, in its rim, or in a saucer below it."""
    saucer_size = (1.6, 0.15)  # share of the outline, and of the soil's height
    outside = 1.12  # share of the outline, within which points belong to the pot
    away, sector = _polar(points, pot.axis)
    share, height = away / pot.outline[sector], points[:, 2]
    saucer = (share < saucer_size[0]) & (height < pot.low + saucer_size[1] * (pot.soil - pot.low))
    below = (share < outside) & (height < pot.soil)
    rim = (share < outside) & (share > _INSIDE) & (height < pot.rim)
    return np.asarray(saucer | below | rim)


def _polar(
    points: Float64[np.ndarray, "P _"], axis: Float64[np.ndarray, "2"]
) -> tuple[Float64[np.ndarray, " P"], Int64[np.ndarray, " P"]]:
    """Return the points' distance from a vertical axis [m], and their sector."""
    offset = points[:, :2] - axis
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1
    return np.hypot(offset[:, 0], offset[:, 1]), np.minimum((turn * _SECTORS).astype(np.int64), _SECTORS - 1)


def _wall(points: Points) -> Wall | None:
    """Find the wall on which most points of a slice lie; None without one."""
    thin_share = 0.1  # largest spread of a wall over its distance from the axis
    most_of_a_slice = 2000  # [points], enough for the outline
    rounds, settled = 6, 0.001  # largest number; relative step at which the axis has converged
    if len(points) < 2 * _SECTORS:
        return None
    points = points[:: -(-len(points) // most_of_a_slice)]
    axis = np.asarray(points[:, :2].mean(axis=0))
    for _ in range(rounds):
        away, sector = _polar(points, axis)
        distance = _middle(away, sector)
        seen = np.isfinite(distance)
        if seen.sum() < _WALLED * _SECTORS:
            return None
        turn = (np.flatnonzero(seen) + 0.5) / _SECTORS * 2 * np.pi
        on = distance[seen, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        circle = np.linalg.lstsq(np.column_stack([2 * on, np.ones(len(on))]), (on**2).sum(axis=1), rcond=None)[0]
        axis = axis + circle[:2]
        if np.hypot(*circle[:2]) < settled * np.median(distance[seen]):
            break
    spread = _middle(np.abs(away - np.nan_to_num(distance)[sector]), sector)
    thin = spread < thin_share * distance  # NaN compares false
    if thin.sum() < _WALLED * _SECTORS:
        return None
    return axis, np.where(thin, distance, np.median(distance[thin]))


def _middle(values: Float64[np.ndarray, " P"], sector: Int64[np.ndarray, " P"]) -> Float64[np.ndarray, " S"]:
    """Return the median of the values (all ≥ 0) in each sector; NaN with fewer than two values."""
    count = np.bincount(sector, minlength=_SECTORS)
    place = np.minimum(np.cumsum(count) - count + count // 2, len(values) - 1)
    scale = 2 * max(float(values.max()), 1e-30)
    in_order = np.sort(sector + values / scale)  # a combined key, three times as fast as sorting by two
    return np.where(count >= 2, (in_order[place] - np.arange(_SECTORS)) * scale, np.nan)


def _joined(walls: Sequence[Wall]) -> Wall:
    """Merge the walls of several slices into one."""
    return np.median([axis for axis, _ in walls], axis=0), np.max([outline for _, outline in walls], axis=0)


def _continues(one: Wall | None, wall: Wall) -> bool:
    """Whether a slice's wall continues the wall of the slices below."""
    if one is None:
        return False
    radius = float(np.median(wall[1]))
    beside = float(np.hypot(*(one[0] - wall[0])))
    return bool(beside < 0.25 * radius and 0.7 < np.median(one[1]) / radius < 1.4)


def _top_of_soil(rows: Sequence[Points], soil: int, wall: Wall) -> int | None:
    """Return the slice above the layer of soil that begins at a slice; None if the layer is not thin."""
    thickest = 5  # [slices], largest thickness of the soil
    rising = 0.65  # largest filled share above and below the soil
    if any(_filled(row, wall) > rising for row in rows[soil - 2 : soil]):
        return None
    tops = range(soil + 1, min(soil + thickest, len(rows) - 1) + 1)
    return next((top for top in tops if _filled(rows[top], wall) <= rising), None)


def _filled(points: Points, wall: Wall) -> float:
    """Return the share of the cells inside the outline that contain a point."""
    num_cells = 8  # number along the outline's radius
    axis, outline = wall
    side = float(np.median(outline)) / num_cells
    across = (np.arange(-num_cells, num_cells) + 0.5) * side
    away, sector = _polar(np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1).reshape(-1, 2), np.zeros(2))
    inside = away < _INSIDE * outline[sector]
    cells = np.floor((points[:, :2] - axis) / side).astype(np.int64) + num_cells
    cells = cells[((cells >= 0) & (cells < 2 * num_cells)).all(axis=1)]
    hold = np.zeros((2 * num_cells, 2 * num_cells), np.bool_)
    hold[cells[:, 0], cells[:, 1]] = True
    return float(hold.ravel()[inside].mean())
