"""Detect still objects in a scene of points: the rules that meshes, splats and scans share.

A scene has points in metres and +Z up, each with the thing that it belongs to: a connected part of a mesh, or a group
of touching points of a cloud. A thing stands still if it

- is flat and wide: a plane, ground or an island at the bottom, or higher if it is vast; or a block below all else;
- is low and apart: in the lowest fifth of the height, and away from things that reach higher;
- is a vessel: it stands at the bottom, is wide at all heights, and either contains named soil, or the thing that rises
  from it or stands on it is narrower there and just above; a trunk below a crown is no pot;
- is a board or rod among others: tables, fences and lattices are four or more long boxes along the same three axes,
  round rods along two perpendicular axes, or a flat thing on three or more legs.

Ground and pots that form one thing with the plant are separated by the points alone: see `ground.py` and `pot.py`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Bool, Float64, Int32, Int64

from dynamictree.mesh import StillPart
from dynamictree.planes import Direction, Points

ThingMask = Bool[np.ndarray, " things"]

GROUND = StillPart(name="ground", why="level and wide, at the bottom")
THINGS = StillPart(name="things", why="low, and apart from what rises higher")
POT = StillPart(name="pot", why="a vessel around the foot of what rises out of it")
BOARDS = StillPart(name="boards", why="long boxes or rods along the same axes, as of furniture, fences and lattices")

LEAST_PLANT = 0.02
"""Least share of faces or points that must remain for the plant."""
LOW_HEIGHT, APART = 0.2, 0.06
"""Largest height of things beside a plant, and least distance from it [share of the height]."""
FOOT = 0.05
"""Largest start above the bottom of things that stand there [share of the height]."""
_FEWEST_OF_ROD, _SQUARE_ROD, _EVEN = 12, 0.8, 0.2
"""Least number of a rod's points, share of them around it, and relative range of their distances from its axis."""
_FEWEST_BOARDS, _LONG, _SQUARE = 4, 4.0, 0.98  # number; longest over middle side; cosine along an axis


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Points, the thing that each belongs to, and properties of the things."""

    points: Points
    thing: Int64[np.ndarray, " P"]
    normals: Points | None = None  # unit normals
    material: Int64[np.ndarray, " things"]  # number, or -1 without material
    soil: ThingMask  # things named as soil
    low: Float64[np.ndarray, "things 3"]  # corners of their bounding boxes
    high: Float64[np.ndarray, "things 3"]

    def floor_and_height(self, gone: ThingMask) -> tuple[float, float]:
        """Return the lowest z and the extent along +Z of the things that are not gone [m]."""
        floor = float(self.low[~gone, 2].min())
        return floor, float(self.high[~gone, 2].max()) - floor


def height_of(points: Points) -> float:
    """Return the extent along +Z without strays [m]."""
    strays = 0.002  # share of the points at each end
    return float(np.ptp(np.quantile(points[:, 2], [strays, 1 - strays])))


def find_planes(scene: Scene, gone: ThingMask) -> ThingMask:
    """Detect planes, patches of ground and islands."""
    flatness = 0.2  # largest height over the narrower width
    wide = 0.5  # least width at the bottom [height of the rest]
    vast_width = 3.0  # least width up to the middle of that height
    extent = scene.high - scene.low
    narrow = extent[:, :2].min(axis=1)
    flat = extent[:, 2] < flatness * narrow
    if (flat | gone).all():
        return np.zeros_like(flat)
    floor, height = scene.floor_and_height(flat | gone)
    middle = (scene.low[:, 2] + scene.high[:, 2]) / 2 - floor
    beneath = (middle < 0.1 * height) & (narrow > wide * height)
    vast = (middle < 0.5 * height) & (narrow > vast_width * height)
    level = flat & (beneath | vast)
    return np.asarray(level | _find_block(scene, gone | level))


def _find_block(scene: Scene, gone: ThingMask) -> ThingMask:
    """Detect a block, such as a pedestal, on which all else stands, with a narrower foot."""
    wider, tallest, near = 1.5, 2.0, 0.01  # [width of the foot]; [its own width]; share of the height
    one = int(np.argmin(np.where(gone, np.inf, scene.low[:, 2])))
    rest = scene.points[~gone[scene.thing] & (scene.thing != one)]
    low, high, within = scene.low[one], scene.high[one], near * scene.floor_and_height(gone)[1]
    foot, sides = rest[rest[:, 2] < high[2] + within], high - low
    if scene.normals is None or len(foot) == 0 or foot[:, 2].min() < high[2] - within:
        return np.zeros_like(gone)
    inside = (foot.min(axis=0) > low)[:2].all() and (foot.max(axis=0) < high)[:2].all()
    holds = inside and sides[:2].min() > max(wider * np.ptp(foot[:, :2], axis=0).max(), sides[2] / tallest)
    is_block = holds and _axes_of_box(scene.normals[scene.thing == one]) is not None
    return np.asarray(np.arange(len(gone)) == (one if is_block else -1))


def find_low_things(scene: Scene, gone: ThingMask, *, slack_m: float = 0.0) -> ThingMask:
    """Detect things beside the plant; things connected with the plant, also indirectly, belong to it.

    `slack_m` is the excess of the distance between two things' points over that between their surfaces.
    """
    floor, height = scene.floor_and_height(gone)
    lying = ~gone & (scene.high[:, 2] < floor + LOW_HEIGHT * height)
    reach = APART * height + slack_m
    rising = scene.points[
        ~(lying | gone)[scene.thing] & (scene.points[:, 2] < floor + LOW_HEIGHT * height + 1.01 * reach)
    ]
    while lying.any() and len(rising):
        rows = np.flatnonzero(lying[scene.thing])
        near = scipy.spatial.cKDTree(rising).query(scene.points[rows], distance_upper_bound=reach)[0]
        hangs = np.unique(scene.thing[rows[np.isfinite(near)]])
        if len(hangs) == 0:
            break
        lying[hangs] = False
        rising = scene.points[np.isin(scene.thing, hangs)]
    return lying if (~(lying | gone)).any() else np.zeros_like(lying)


def find_vessels(scene: Scene, gone: ThingMask) -> ThingMask:
    """Detect pots, vases and planters, by the soil inside or the plant that rises from them."""
    vessel, with_soil = 0.5, 0.75  # share of the height: highest top of a vessel, and of one with soil
    low, high = scene.low, scene.high
    floor, height = scene.floor_and_height(gone)
    stands = ~gone & (low[:, 2] < floor + FOOT * height) & (high[:, 2] < floor + with_soil * height)
    detected = np.zeros_like(gone)
    for one in np.flatnonzero(stands)[np.argsort(-(high - low)[stands, :2].max(axis=1))][:50]:
        if _holds_soil(scene, one) or (high[one, 2] <= floor + vessel * height and _encloses(scene, gone, one, height)):
            detected[one] = _wide_all_the_way(scene.points[scene.thing == one])
        if detected[one]:  # its soil without a name, too
            detected |= ~gone & (low >= low[one]).all(axis=1) & (high <= high[one]).all(axis=1)
    return detected


def _holds_soil(scene: Scene, one: np.int64) -> bool:
    """Whether a thing has soil in its upper half, about as wide as itself: named so, or a disc if it is no trunk."""
    soil_size, flatness, slenderest = 0.5, 0.1, 2.0  # [vessel]; most height of unnamed soil and its vessel [own width]
    low, extents = scene.low[one], scene.high - scene.low
    flat, extent = extents[:, 2] < flatness * extents[:, :2].min(axis=1), extents[one]
    soil = scene.soil | (flat & (extent[2] < slenderest * extent[:2].min()))
    inner_low, inner_high = scene.low[soil], scene.high[soil]
    inside = ((inner_low >= low - 0.1 * extent) & (inner_high <= low + 1.1 * extent)).all(axis=1)
    wide = ((inner_high - inner_low)[:, :2] > soil_size * extent[:2]).all(axis=1)
    return bool((inside & wide & ((inner_low + inner_high)[:, 2] / 2 > low[2] + soil_size * extent[2])).any())


def _encloses(scene: Scene, gone: ThingMask, one: np.int64, height: float) -> bool:
    """Whether the things that rise from a thing, or stand on it, are narrower there and just above."""
    wider = 1.5  # least ratio of a vessel's width to that of the enclosed foot
    on_top = 0.01  # share of the height; things that start this near to the top stand on it
    above, slice = (0.03, 0.06, 0.1), 0.02  # share of the rising part: heights over the rim, thickness of a slice
    low, high = scene.low, scene.high
    rim = float(high[one, 2])
    base = rim + on_top * height * (scene.material != scene.material[one])  # the same material means the same thing
    rises = ~gone & (high[:, 2] > 2 * rim - low[one, 2]) & (low[:, 2] < base)
    places = scene.points[rises[scene.thing]]
    foot = places[places[:, 2] <= float(base.max()), :2]
    if len(foot) == 0:
        return False
    foot_low, foot_high = foot.min(axis=0), foot.max(axis=0)
    if not ((foot_low >= low[one, :2]) & (foot_high <= high[one, :2])).all():
        return False
    rise = float(places[:, 2].max()) - rim
    widest = max(_width_at(places, rim + share * rise, slice * rise) for share in above)
    return bool(float((high - low)[one, :2].min()) > max(wider * float((foot_high - foot_low).max()), widest))


def _width_at(points: Points, level: float, thickness: float) -> float:
    """Return the longer horizontal side of a slice, without outlying twigs."""
    places = points[np.abs(points[:, 2] - level) < thickness / 2, :2]
    if len(places) == 0:
        return 0.0
    return float(np.ptp(np.quantile(places, [0.1, 0.9], axis=0), axis=0).max())


def _wide_all_the_way(points: Points) -> bool:
    """Whether the outline is wide both at the bottom and at the top, unlike that of a branching stem."""
    share = (points[:, 2] - points[:, 2].min()) / max(float(np.ptp(points[:, 2])), 1e-12)
    away = np.linalg.norm(points[:, :2] - points[:, :2].mean(axis=0), axis=1)
    ends = [away[share < 0.25].max(initial=0), away[share > 0.75].max(initial=0)]
    return bool(min(ends) > 0.4 * away.max())


def find_boards(scene: Scene, gone: ThingMask) -> ThingMask:
    """Detect boards: long boxes with the axes of at least three others, lattices of rods, flat things on legs."""
    detected = np.zeros_like(gone)
    if scene.normals is None:
        return detected
    order = np.argsort(scene.thing, kind="stable")
    ends = np.searchsorted(scene.thing[order], np.arange(len(gone) + 1))
    short, middle, longest = np.sort(scene.high - scene.low, axis=1).T
    long = np.flatnonzero(~gone & ((longest > _LONG * middle) | ((middle > _LONG * short) & (short > 0))))
    axes = {one: _axes_of_box(scene.normals[order[ends[one] : ends[one + 1]]]) for one in long}
    rods = {
        one: _axis_of_rod(scene.points[rows], scene.normals[rows])
        for one in long
        if axes[one] is None and len(rows := order[ends[one] : ends[one + 1]]) >= _FEWEST_OF_ROD
    }
    detected[_lattice_rods({one: own for one, own in rods.items() if own is not None})] = True
    boxes = {one: own for one, own in axes.items() if own is not None}
    for own in list(boxes.values())[:50]:
        alike = [one for one, other in boxes.items() if (np.abs(own @ other.T).max(axis=1) > _SQUARE).all()]
        if len(alike) >= _FEWEST_BOARDS:
            detected[alike] = True
    return np.asarray(detected | _on_legs(scene, gone))


def _on_legs(scene: Scene, gone: ThingMask) -> ThingMask:
    """Detect flat things on three or more legs of equal height, with the legs."""
    fewest, low_top, wide, flatness = 3, 0.6, 0.1, 0.2  # [legs]; [height] for the top's largest z and least width
    detected = np.zeros_like(gone)
    floor, height = scene.floor_and_height(gone)
    low, high, near = scene.low, scene.high, FOOT * height
    narrow = (high - low)[:, :2].min(axis=1)
    flat = ~gone & (high[:, 2] - low[:, 2] < flatness * narrow) & (narrow > wide * height)
    for top in np.flatnonzero(flat & (high[:, 2] < floor + low_top * height)):
        legs = ~gone & (low[:, 2] < floor + near) & (np.abs(high[:, 2] - low[top, 2]) < near)
        legs &= ((low < high[top] + near) & (high > low[top] - near))[:, :2].all(axis=1) & (narrow < narrow[top] / 2)
        if legs.sum() >= fewest:
            detected[[top, *np.flatnonzero(legs)]] = True
    return detected


def _lattice_rods(rods: Mapping[np.int64, Direction]) -> list[np.int64]:
    """Find the rods of a lattice: two or more along one axis, and two or more perpendicular to it."""
    for own in list(rods.values())[:50]:
        along = {one: abs(float(own @ other)) for one, other in rods.items()}
        alike = [one for one, cosine in along.items() if cosine > _SQUARE]
        across = [one for one, cosine in along.items() if cosine < 1 - _SQUARE]
        if min(len(alike), len(across)) >= _FEWEST_BOARDS // 2:
            return alike + across
    return []


def _axis_of_rod(points: Points, normals: Points) -> Direction | None:
    """Return the axis of a straight round rod of even thickness; None for other shapes, such as tapering stems."""
    side = np.linalg.eigh(normals.T @ normals)[1][:, 0]  # axis perpendicular to all normals except those of the ends
    across = np.abs(normals @ side) < 1 - _SQUARE
    if across.mean() < _SQUARE_ROD or np.abs(normals[~across] @ side).min(initial=1) < _SQUARE:
        return None
    around = points[across] - points[across].mean(axis=0)
    away = np.linalg.norm(around - (around @ side)[:, None] * side, axis=1)
    even = np.ptp(away) < _EVEN * away.mean() and np.ptp(around @ side) > _LONG * away.mean()
    return side if even else None


def _axes_of_box(normals: Points) -> Float64[np.ndarray, "3 3"] | None:
    """Return the three perpendicular axes of a box, from its normals; None if it is no box."""
    first = normals[0]
    second = normals[np.argmin(np.abs(normals @ first))]
    if abs(first @ second) > 1 - _SQUARE:
        return None
    axes = np.stack([first, second, np.cross(first, second)])
    along = normals @ axes.T
    if np.abs(along).max(axis=1).min() < _SQUARE or (along.min(axis=0) > -_SQUARE).any():
        return None
    return None if (along.max(axis=0) < _SQUARE).any() else axes


def touching_groups(
    points: Points, side_m: float
) -> tuple[Int64[np.ndarray, "C 3"], Int64[np.ndarray, " P"], Int64[np.ndarray, " C"], Int32[np.ndarray, " C"]]:
    """Return a grid's occupied cells, each point's cell, the cells' numbers of points, and their connected groups."""
    places = np.floor((points - points.min(axis=0)) / side_m).astype(np.int64)
    span = places.max(axis=0) + 1
    keys, cell, count = np.unique(
        (places * [span[1] * span[2], span[2], 1]).sum(axis=1), return_inverse=True, return_counts=True
    )
    cells = np.stack([keys // (span[1] * span[2]), keys // span[2] % span[1], keys % span[2]], axis=1)
    return cells, cell.ravel(), count, groups_of_cells(cells)


def groups_of_cells(cells: Int64[np.ndarray, "C 3"]) -> Int32[np.ndarray, " C"]:
    """Label connected groups of cells, which touch by face, edge or corner."""
    pairs = scipy.spatial.cKDTree(cells).query_pairs(1.8, output_type="ndarray")
    joined = scipy.sparse.coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cells),) * 2)
    return np.asarray(scipy.sparse.csgraph.connected_components(joined, directed=False)[1])
