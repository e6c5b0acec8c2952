"""Detect the still parts of a splat or scan: sky, ground, tables, pots, things and floaters.

Parts are detected only if their shape is unambiguous; users select others with a box or a mask.
"""

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Bool, UInt8

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import StillPart, part_bounds
from dynamictree.planes import Points
from dynamictree.plant.ground import find_ground
from dynamictree.plant.pot import find_pot, in_pot
from dynamictree.plant.still import (
    APART,
    GROUND,
    LEAST_PLANT,
    LOW_HEIGHT,
    POT,
    THINGS,
    Scene,
    find_low_things,
    height_of,
    touching_groups,
)

SKY = StillPart(name="sky", why="far around everything that hangs together")
FLOATERS = StillPart(name="floaters", why="a few Gaussians far from all others")
_SOLID = 0.05  # least opacity
_FEWEST_POINTS = 500
_SKY_CELL, _SKY_AWAY, _NOT_SKY = 0.1, 3.0, 0.5
"""Share of the median distance from the middle, within which points are connected; ratio of the sky's distance to the
radius of the connected rest; least share of that rest."""


def find_still_gaussians(cloud: GaussianCloud) -> tuple[tuple[StillPart, ...], UInt8[np.ndarray, " G"]]:
    """Detect the still parts of a cloud [m, +Z up]; return them and each Gaussian's part from 1, or 0."""
    large = 0.1  # share of the extent; larger Gaussians are background
    small = 0.2  # largest share of the points of things, or of floaters
    part_of = np.zeros(cloud.num_gaussians, np.uint8)
    parts: list[StillPart] = []

    def take(part: StillPart, rows: Bool[np.ndarray, " G"]) -> None:
        rows = rows & (part_of == 0)
        left = solid & (part_of == 0) & ~rows
        if rows.any() and left.sum() >= max(LEAST_PLANT * solid.sum(), _FEWEST_POINTS / 10):
            if part not in parts:
                parts.append(part)
            part_of[rows] = 1 + parts.index(part)

    means = cloud.means.astype(np.float64)
    sky = find_sky(cloud)
    solid = ~sky & (cloud.opacity >= _SOLID)
    solid &= cloud.scales.max(axis=1) <= large * np.ptp(means[~sky], axis=0).max()
    if solid.sum() < _FEWEST_POINTS:
        return (), part_of
    take(SKY, sky)
    rng = np.random.default_rng(0)
    for _ in range(2):  # a floor, then a table on it
        points = _thinned(means[solid & (part_of == 0)])
        plane = find_ground(points, height_of(points), rng)
        if plane is None:
            break
        take(GROUND, (plane.above(means) <= 0) & ~sky)
    free = solid & (part_of == 0)
    height_m = height_of(means[free])
    if not height_m > 0:
        return tuple(parts), part_of
    things, floaters = _apart(means[free], height_m)
    for part, lying in ((THINGS, things), (FLOATERS, floaters)):
        if lying.mean() <= small and (part == FLOATERS or GROUND in parts):
            rows = np.zeros(len(means), np.bool_)
            rows[free] = lying
            take(part, rows)
    pot = find_pot(_thinned(means[solid & (part_of == 0)]), height_m, rng)
    if pot is not None:
        take(POT, in_pot(pot, means))
    return tuple(parts), part_of


def find_sky(cloud: GaussianCloud) -> Bool[np.ndarray, " G"]:
    """Detect Gaussians far outside the connected rest, such as a dome optimised for the sky."""
    means = cloud.means.astype(np.float64)
    solid = np.flatnonzero(cloud.opacity >= _SOLID)
    nothing = np.zeros(len(means), np.bool_)
    if len(solid) < _FEWEST_POINTS:
        return nothing
    away = np.linalg.norm(means[solid] - np.median(means[solid], axis=0), axis=1)
    if not np.median(away) > 0:
        return nothing
    near = solid[away < away.max() / _SKY_AWAY]  # a wide scene without sky has most points farther out
    if len(near) < _NOT_SKY * len(solid):
        return nothing
    _, cell, count, group = touching_groups(means[near], _SKY_CELL * float(np.median(away)))
    together = near[(group == np.bincount(group, count).argmax())[cell]]
    if len(together) < _NOT_SKY * len(solid):
        return nothing
    middle = np.median(means[together], axis=0)
    radius = float(np.linalg.norm(means[together] - middle, axis=1).max())
    return np.asarray(np.linalg.norm(means - middle, axis=1) > _SKY_AWAY * radius)


def _thinned(points: Points) -> Points:
    most_points = 200_000
    return points[:: -(-len(points) // most_points)]


def _apart(points: Points, height_m: float) -> tuple[Bool[np.ndarray, " P"], Bool[np.ndarray, " P"]]:
    """Detect low points apart from the plant, and small groups far from the largest one."""
    cell_share = 0.03  # share of the height
    few_share = 0.02  # largest share of the points in a floater
    side = cell_share * height_m
    cells, cell, count, group = touching_groups(points, side)
    size = np.bincount(group, count)
    unknown = np.full(len(size), -1)
    places, thing = cells * side, group.astype(np.int64)
    bounds = part_bounds(thing, places)
    scene = Scene(points=places, thing=thing, low=bounds[0], high=bounds[1], material=unknown, soil=unknown > 0)
    low = find_low_things(scene, np.zeros(len(size), np.bool_), slack_m=side)
    main = cells[group == size.argmax()]
    gap = np.full(len(size), np.inf)
    np.minimum.at(gap, group, scipy.spatial.cKDTree(main).query(cells)[0] * side)
    above = bounds[1][:, 2] >= main[:, 2].min() * side + LOW_HEIGHT * height_m  # lower groups may lie on the ground
    few = above & (gap > APART * height_m + side) & (size < few_share * size.sum())
    return low[group][cell], few[group][cell]
