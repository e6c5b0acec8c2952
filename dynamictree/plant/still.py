"""What in a scene of points is no plant: the rules that meshes, splats and scans share.

A scene is points in metres and +Z up, and of each the thing that it is of: a connected part of a mesh, or points of a
cloud that touch. A thing stands still that

- is flat and wide: a plane, a patch of ground, an island, at the bottom, or higher where it is vast;
- lies low and apart: all of it in the lowest fifth of the height, away from whatever reaches higher;
- is a vessel: it stands at the bottom, is wide all the way up, and either holds named soil, or what rises out of it or
  stands on it is narrower there and just above: a trunk below a crown is no pot;
- is a board or rod among others: tables, fences and lattices are four or more long boxes along the same three axes,
  round rods along two that cross at right angles, or something flat on three or more legs.

What is one thing with the plant is separated from it by its points alone: see `ground.py` and `pot.py`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Bool, Float64, Int32, Int64

from dynamictree.mesh import StillPart
from dynamictree.planes import Direction, Points

Things = Bool[np.ndarray, " things"]

GROUND = StillPart(name="ground", why="level and wide, at the bottom")
THINGS = StillPart(name="things", why="low, and apart from what rises higher")
POT = StillPart(name="pot", why="a vessel around the foot of what rises out of it")
BOARDS = StillPart(name="boards", why="long boxes or rods along the same axes, as of furniture, fences and lattices")

LEAST_PLANT = 0.02
"""Of the faces or points: with less left over, nothing is taken away."""
LOW, APART = 0.2, 0.06
"""Of the height: so high things beside a plant reach; and what is so far from it does not hang on it."""
FOOT = 0.05
"""Of the height: what stands at the bottom begins at most so high."""
_FEWEST_OF_ROD, _SQUARE_ROD, _EVEN = 12, 0.8, 0.2
"""Points of a rod, share of them around it, and by how much of its radius their distances from its axis differ."""
_FEWEST_BOARDS, _LONG, _SQUARE = 4, 4.0, 0.98  # and a board's longest side over its middle one; cosine along an axis


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Points, the thing that each is of, and what is known of the things."""

    points: Points
    thing: Int64[np.ndarray, " P"]
    normals: Points | None = None  # of unit length
    material: Int64[np.ndarray, " things"]  # number, -1 where there is none
    soil: Things  # by name
    low: Float64[np.ndarray, "things 3"]  # corners of the boxes around them
    high: Float64[np.ndarray, "things 3"]

    def floor_and_height(self, gone: Things) -> tuple[float, float]:
        """Lowest place, and extent along +Z, of what is left [m]."""
        floor = float(self.low[~gone, 2].min())
        return floor, float(self.high[~gone, 2].max()) - floor


def height_of(points: Points) -> float:
    """Extent along +Z without strays [m]."""
    strays = 0.002  # of the points at each end
    return float(np.ptp(np.quantile(points[:, 2], [strays, 1 - strays])))


def flat_and_wide(scene: Scene, gone: Things) -> Things:
    """Planes, patches of ground, islands."""
    flatness = 0.2  # height over the narrower width of what is flat
    wide = 0.5  # its width at the bottom, of the height of what rises
    vast_width = 3.0  # and up to the middle of that height
    extent = scene.high - scene.low
    narrow = extent[:, :2].min(axis=1)
    flat = extent[:, 2] < flatness * narrow
    if (flat | gone).all():
        return np.zeros_like(flat)
    floor, height = scene.floor_and_height(flat | gone)
    middle = (scene.low[:, 2] + scene.high[:, 2]) / 2 - floor
    beneath = (middle < 0.1 * height) & (narrow > wide * height)
    vast = (middle < 0.5 * height) & (narrow > vast_width * height)
    return np.asarray(flat & (beneath | vast))


def low_and_apart(scene: Scene, gone: Things, *, slack_m: float = 0.0) -> Things:
    """Things beside the plant; what hangs on what rises, and what hangs on that, is of the plant.

    `slack_m` is how much farther apart than their surfaces the points of two things are.
    """
    floor, height = scene.floor_and_height(gone)
    lying = ~gone & (scene.high[:, 2] < floor + LOW * height)
    rising = scene.points[~(lying | gone)[scene.thing]]
    while lying.any() and len(rising):
        rows = np.flatnonzero(lying[scene.thing])
        near = scipy.spatial.cKDTree(rising).query(scene.points[rows], distance_upper_bound=APART * height + slack_m)[0]
        hangs = np.unique(scene.thing[rows[np.isfinite(near)]])
        if len(hangs) == 0:
            break
        lying[hangs] = False
        rising = scene.points[np.isin(scene.thing, hangs)]
    return lying if (~(lying | gone)).any() else np.zeros_like(lying)


def vessels(scene: Scene, gone: Things) -> Things:
    """Pots, vases and planters, with what they hold or what stands on them."""
    vessel, with_soil = 0.5, 0.75  # of the height: a vessel reaches up so far at most; and one that holds soil
    low, high = scene.low, scene.high
    floor, height = scene.floor_and_height(gone)
    stands = ~gone & (low[:, 2] < floor + FOOT * height) & (high[:, 2] < floor + with_soil * height)
    detected = np.zeros_like(gone)
    for one in np.flatnonzero(stands)[np.argsort(-(high - low)[stands, :2].max(axis=1))][:50]:
        if _holds_soil(scene, one) or (high[one, 2] <= floor + vessel * height and _encloses(scene, gone, one, height)):
            detected[one] = _wide_all_the_way(scene.points[scene.thing == one])
    return detected


def _holds_soil(scene: Scene, one: np.int64) -> bool:
    """Whether a thing has soil in its upper half that is about as wide."""
    soil_size = 0.5  # of a vessel's width, and of its height, at least, so wide and so high lies soil in it
    low, extent = scene.low[one], (scene.high - scene.low)[one]
    inner_low, inner_high = scene.low[scene.soil], scene.high[scene.soil]
    inside = ((inner_low >= low - 0.1 * extent) & (inner_high <= low + 1.1 * extent)).all(axis=1)
    lies_high = (inner_low + inner_high)[:, 2] / 2 > low[2] + soil_size * extent[2]
    wide = ((inner_high - inner_low)[:, :2] > soil_size * extent[:2]).all(axis=1)
    return bool((inside & lies_high & wide).any())


def _encloses(scene: Scene, gone: Things, one: np.int64, height: float) -> bool:
    """Whether what rises out of a thing, or stands on it, is narrower there and just above."""
    wider = 1.5  # than what it encloses is a vessel
    on_top = 0.01  # of the height: what begins so near to the top stands on it
    above, slice = (0.03, 0.06, 0.1), 0.02  # of the height of what rises: here, over the rim, it is narrower; thickness
    low, high = scene.low, scene.high
    rim = float(high[one, 2])
    base = rim + on_top * height * (scene.material != scene.material[one])  # what is of one material is one thing
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
    width = float((high - low)[one, :2].min())
    return bool(width > max(wider * float((foot_high - foot_low).max()), widest))


def _width_at(points: Points, level: float, thickness: float) -> float:
    """The longer side, seen from above, of a slice, without outlying twigs."""
    places = points[np.abs(points[:, 2] - level) < thickness / 2, :2]
    if len(places) == 0:
        return 0.0
    return float(np.ptp(np.quantile(places, [0.1, 0.9], axis=0), axis=0).max())


def _wide_all_the_way(points: Points) -> bool:
    """Whether its outline is wide at every one of four heights, as a pot's is and a branching stem's is not."""
    share = (points[:, 2] - points[:, 2].min()) / max(float(np.ptp(points[:, 2])), 1e-12)
    away = np.linalg.norm(points[:, :2] - points[:, :2].mean(axis=0), axis=1)
    ends = [away[share < 0.25].max(initial=0), away[share > 0.75].max(initial=0)]
    return bool(min(ends) > 0.4 * away.max())


def boards(scene: Scene, gone: Things) -> Things:
    """Long boxes that lie along the same three axes as three others or more; not where nothing else is left."""
    detected = np.zeros_like(gone)
    if scene.normals is None:
        return detected
    order = np.argsort(scene.thing, kind="stable")
    ends = np.searchsorted(scene.thing[order], np.arange(len(gone) + 1))
    long = [one for one in np.flatnonzero(~gone) if _may_be_board(scene.high[one] - scene.low[one])]
    axes = {one: _axes_of_box(scene.normals[order[ends[one] : ends[one + 1]]]) for one in long}
    rods = {
        one: _axis_of_rod(scene.points[rows], scene.normals[rows])
        for one in long
        if axes[one] is None and len(rows := order[ends[one] : ends[one + 1]]) >= _FEWEST_OF_ROD
    }
    detected[_crossing({one: own for one, own in rods.items() if own is not None})] = True
    boxes = {one: own for one, own in axes.items() if own is not None}
    for own in list(boxes.values())[:50]:
        alike = [one for one, other in boxes.items() if (np.abs(own @ other.T).max(axis=1) > _SQUARE).all()]
        if len(alike) >= _FEWEST_BOARDS:
            detected[alike] = True
    return np.asarray(detected | _on_legs(scene, gone))


def _on_legs(scene: Scene, gone: Things) -> Things:
    """Flat things that lie on three or more legs of one height, and the legs."""
    fewest, low_top, wide, flatness = 3, 0.6, 0.1, 0.2  # legs; the top is lower, and wider, than so many heights
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


def _crossing(rods: Mapping[np.int64, Direction]) -> list[np.int64]:
    """Rods of a lattice: two or more along one axis, and two or more across it."""
    for own in list(rods.values())[:50]:
        along = {one: abs(float(own @ other)) for one, other in rods.items()}
        alike = [one for one, cosine in along.items() if cosine > _SQUARE]
        across = [one for one, cosine in along.items() if cosine < 1 - _SQUARE]
        if min(len(alike), len(across)) >= _FEWEST_BOARDS // 2:
            return alike + across
    return []


def _axis_of_rod(points: Points, normals: Points) -> Direction | None:
    """The direction of a straight round rod of even thickness; None if it is none, as of stems that taper or bend."""
    side = np.linalg.eigh(normals.T @ normals)[1][:, 0]  # across all normals but those of its ends
    across = np.abs(normals @ side) < 1 - _SQUARE
    if across.mean() < _SQUARE_ROD or np.abs(normals[~across] @ side).min(initial=1) < _SQUARE:
        return None
    around = points[across] - points[across].mean(axis=0)
    away = np.linalg.norm(around - (around @ side)[:, None] * side, axis=1)
    even = np.ptp(away) < _EVEN * away.mean() and np.ptp(around @ side) > _LONG * away.mean()
    return side if even else None


def _may_be_board(extent: Direction) -> bool:
    _, middle, longest = np.sort(extent)
    return bool(longest > _LONG * middle or middle > _LONG * extent.min() > 0)


def _axes_of_box(normals: Points) -> Float64[np.ndarray, "3 3"] | None:
    """The three directions along which all normals are, to both sides, at right angles; None if it is no box."""
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
    """Filled cells of a grid, the cell of each point, their numbers of points, and their groups of cells that touch."""
    places = np.floor((points - points.min(axis=0)) / side_m).astype(np.int64)
    span = places.max(axis=0) + 1
    keys, cell, count = np.unique(
        (places * [span[1] * span[2], span[2], 1]).sum(axis=1), return_inverse=True, return_counts=True
    )
    cells = np.stack([keys // (span[1] * span[2]), keys // span[2] % span[1], keys % span[2]], axis=1)
    return cells, cell.ravel(), count, groups_of_cells(cells)


def groups_of_cells(cells: Int64[np.ndarray, "C 3"]) -> Int32[np.ndarray, " C"]:
    """Number of the group of each cell, of cells that touch by face, edge or corner."""
    pairs = scipy.spatial.cKDTree(cells).query_pairs(1.8, output_type="ndarray")
    joined = scipy.sparse.coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(cells),) * 2)
    return np.asarray(scipy.sparse.csgraph.connected_components(joined, directed=False)[1])
