"""Detect the up axis of a mesh from several weighted cues, with a confidence.

Each of the six axes is a candidate. Its cues, from points spread evenly over the surface, are:

- trunk: height up to which the shape is narrow, from the bottom up and from the top down;
- balance: distance of the centre from the axis through the foot (the lowest twelfth);
- wood: height of leaves above wood, by the names of materials;
- stem: gap of the largest part from the top minus its gap from the foot;
- taper: thickness at the foot over that at the tip, if the trunk is a separate part;
- mass: mean height of the surface;
- slenderness: height over width.

Their weights are fitted by a conditional logit (McFadden 1974) to trees of known axis, see docs/decisions/core.md.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from dynamictree.axis_names import AXES
from dynamictree.mesh import TriangleMesh, connected_parts, part_bounds, weld
from dynamictree.plant.names import LEAF, WOOD
from dynamictree.plant.plausibility import FEWEST_GAUSSIANS
from dynamictree.plant.sample import surface_points
from dynamictree.plant.still import touching_groups
from dynamictree.plant.still_mesh import find_still_parts
from dynamictree.up_axis import up_rotation

CERTAIN = 0.8
"""Probability below which the axis is a guess, and the reader warns."""
SURE_OF_POINTS = 0.95
"""The same for points, which are less reliable than surfaces: conifers score up to 0.91 upside down."""

CUES = ("trunk", "trunk-from-top", "balance", "wood", "wood-foot", "stem", "taper", "mass", "slenderness")
WEIGHTS = np.array([5.13, -6.65, -1.60, 12.30, 6.06, 0.35, 1.68, 1.02, 2.27])
HABIT_LOGIT = 0.7
"""Added to the logit of a format's usual axis; it decides if the shape is ambiguous."""
USUAL_AXES, LIKELY = ("+Y", "+Z"), 0.65
"""If no axis is likely, the likelier of these is chosen, since files with other axes are rare."""

_POINTS = 20_000
_APART, _SHARE = 0.03, 0.05
"""Share of the longest side that separates two trees; least share of the points in one tree."""


@dataclass(frozen=True, kw_only=True)
class UpAxis:
    """Most likely up axis and its probability."""

    axis: str
    confidence: float  # probability in [0, 1]
    upright: float = 0.0  # probability of +Z
    lying: float = 0.0  # probability of ±X and ±Y; for points, adjusted by the feet's widths


def judge_up_axis(mesh: TriangleMesh, *, habit: str | None = None) -> UpAxis:
    """Estimate the up axis of a mesh in its file's axes; `habit` is the usual axis of the file's format.

    If the result is uncertain, each axis is judged again without the parts that would be still if it were up.
    """
    cues = axis_cues(mesh)
    if cues is None:
        return UpAxis(axis=habit or "+Z", confidence=0.0)
    judged = _likeliest(cues, habit)
    if judged.confidence >= CERTAIN:
        return judged
    alone = np.stack([_cues_of_plant(mesh, axis, row) for axis, row in zip(AXES, cues, strict=True)])
    second = _likeliest(alone, habit)
    return second if second.confidence > judged.confidence else judged


def judge_standing(mesh: TriangleMesh) -> UpAxis | None:
    """Estimate the up axis of a mesh whose stated up axis is +Z; None for a mesh without surface."""
    cues = axis_cues(mesh)
    return None if cues is None else _likeliest(cues, "+Z", any_axis=True)


def judge_each_standing(mesh: TriangleMesh) -> UpAxis | None:
    """Estimate the up axis of most of several separate trees, each judged alone; None for a single tree."""
    sampled = surface_points(mesh, _POINTS)
    if sampled is None:
        return None
    points, faces = sampled
    _, cell, _, group_of_cell = touching_groups(points, _APART * float(np.ptp(points, axis=0).max()))
    group = group_of_cell[cell]
    large = np.flatnonzero(np.bincount(group) > _SHARE * len(points))  # several trees together are wide
    if len(large) < 2:
        return None
    of_face = np.full(mesh.num_faces, -1)
    of_face[faces] = group  # faces without a sampled point are ignored
    judged = [own for one in large if (own := judge_standing(replace(mesh, still_faces=of_face != one).moving_part))]
    chances = {axis: [own.confidence for own in judged if own.axis == axis] for axis in AXES}
    axis = max(AXES, key=lambda one: len(chances[one]))
    if len(judged) < 2 or 2 * len(chances[axis]) <= len(judged):
        return None
    upright = float(np.mean([own.upright for own in judged]))
    return UpAxis(axis=axis, confidence=float(np.mean(chances[axis])), upright=upright)


def _likeliest(cues: Float64[np.ndarray, "6 C"], habit: str | None, *, any_axis: bool = False) -> UpAxis:
    """Return the likeliest axis; if it is a guess, the likelier of the usual ones, unless `any_axis`."""
    usual = 3.0  # ratio of probabilities from which a guess is not the usual axis; ferns and rosettes are wide
    logits = cues @ WEIGHTS + np.array([HABIT_LOGIT * (axis == habit) for axis in AXES])
    odds = np.exp(logits - logits.max())
    chances = (odds / odds.sum()).tolist()
    best = int(np.argmax(chances))
    if chances[best] < LIKELY and not any_axis:
        best = max((AXES.index(one) for one in USUAL_AXES), key=lambda i: chances[i] * usual ** (AXES[i] == habit))
    return UpAxis(axis=AXES[best], confidence=chances[best], upright=chances[4], lying=sum(chances[:4]))  # as in AXES


def _cues_of_plant(mesh: TriangleMesh, axis: str, cues: Float64[np.ndarray, " C"]) -> Float64[np.ndarray, " C"]:
    """Compute the cues of one axis without the still parts that it would have as up; `cues` if there are none."""
    column, sign = "XYZ".index(axis[1]), 1 if axis[0] == "+" else -1
    others = [other for other in range(3) if other != column]
    standing = np.stack([mesh.vertices[:, others[0]], mesh.vertices[:, others[1]], sign * mesh.vertices[:, column]], 1)
    still = find_still_parts(mesh.with_vertices(np.ascontiguousarray(standing)))[1]
    plant = None if still is None else axis_cues(replace(mesh, still_faces=still).moving_part, axes=(axis,))
    return cues if plant is None else np.asarray(plant[0])


def judge_up_axis_of_points(points: Float32[np.ndarray, "P 3"]) -> UpAxis:
    """Estimate the up axis of a splat's or scan's points, without outliers; the confidence is 0 for few points."""
    if len(points) < FEWEST_GAUSSIANS:
        return UpAxis(axis="+Z", confidence=0.0)
    outliers = (0.002, 0.998)  # quantiles of the coordinates
    by_foot = 0.25  # middle of 0.15 to 0.35, which detect about the same number of lying scans
    drawn = points[np.random.default_rng(0).permutation(len(points))[:_POINTS]].astype(np.float64)
    low, high = np.quantile(drawn, outliers, axis=0)
    drawn = drawn[((drawn >= low) & (drawn <= high)).all(axis=1)]
    unknown = np.zeros(len(drawn), np.int64)
    judged = _likeliest(_cues_of_points(drawn, unknown, unknown, AXES), "+Z", any_axis=True)
    widths = [_foot_width(drawn @ up_rotation(axis).T) for axis in AXES[:5]]
    return replace(judged, lying=judged.lying + by_foot * float(np.log(widths[4] / min(widths[:4]))))


def _foot_width(points: Float64[np.ndarray, "P 3"]) -> float:
    """Return the mean radius of the largest clump at the bottom [longest side]; a trunk is narrow."""
    foot, cell, thinnest = 0.08, 0.04, 0.003  # share of the height; shares of the longest side
    side = max(float(np.ptp(points, axis=0).max()), 1e-30)
    low = points[points[:, 2] <= points[:, 2].min() + foot * np.ptp(points[:, 2])]
    _, cell_of, _, group = touching_groups(low, cell * side)
    clump = low[group[cell_of] == np.bincount(group[cell_of]).argmax(), :2]
    return thinnest + float(np.linalg.norm(clump - clump.mean(axis=0), axis=1).mean()) / side


def axis_cues(mesh: TriangleMesh, axes: tuple[str, ...] = AXES) -> Float64[np.ndarray, "A C"] | None:
    """Compute the cues of each axis, in the order of `CUES`; None for a mesh without surface."""
    sampled = surface_points(mesh, _POINTS)
    if sampled is None:
        return None
    points, faces = sampled
    return _cues_of_points(points, _material_kinds(mesh)[faces], _largest_part(mesh)[faces], axes)


def _cues_of_points(
    points: Float64[np.ndarray, "P 3"],
    kind: Int64[np.ndarray, " P"],  # 1 wood, 2 leaf, 0 unknown
    stem: Int64[np.ndarray, " P"],
    axes: tuple[str, ...],
) -> Float64[np.ndarray, "A C"]:
    points = np.asfortranarray(points)  # contiguous coordinates
    points = (points - points.min(axis=0)) / max(float(np.ptp(points, axis=0).max()), 1e-30)
    rows = []
    for axis in axes:
        column = "XYZ".index(axis[1])
        height = points[:, column] if axis[0] == "+" else points[:, column].max() - points[:, column]
        across = np.delete(points, column, axis=1)
        rows.append(_cues_along(height, across, kind, stem))
    return np.array(rows)


def _cues_along(
    height: Float64[np.ndarray, " P"],
    across: Float64[np.ndarray, "P 2"],
    kind: Int64[np.ndarray, " P"],
    stem: Int64[np.ndarray, " P"],
) -> list[float]:
    slices = 24
    foot_slices = 2
    narrow = 0.4  # share of the whole's spread
    extent = max(float(height.max()), 1e-6)
    share = height / extent
    whole = max(float(_spreads(across, np.zeros(len(across), np.int64), 1)[0]), 1e-6)
    number = np.minimum((share * slices).astype(int), slices - 1)
    radii = _spreads(across, number, slices)
    low = number < foot_slices
    wide = radii > narrow * whole
    trunk, from_top = (int(np.argmax(side)) if side.any() else slices for side in (wide, wide[::-1]))
    balance = np.linalg.norm(across[low].mean(axis=0) - across.mean(axis=0)) / whole if low.any() else 1.0
    wood, leaf = kind == 1, kind == 2
    by_name = wood.any() and leaf.any()
    largest = share[stem == 1]
    return [
        trunk / slices,
        from_top / slices,
        min(float(balance), 3.0),
        float(share[leaf].mean() - share[wood].mean()) if by_name else 0.0,
        float(share[leaf].min() - share[wood].min()) if by_name else 0.0,
        float((1 - largest.max()) - largest.min()) if len(largest) else 0.0,
        _taper(share, across, stem == 1),
        float(share.mean() - 0.5),
        float(np.log(extent / max(float(np.ptp(across, axis=0).max()), 1e-6)).clip(-1.5, 1.5)),
    ]


def _taper(share: Float64[np.ndarray, " P"], across: Float64[np.ndarray, "P 2"], stem: Bool[np.ndarray, " P"]) -> float:
    """Return the log ratio of the stem's widths at foot and tip, if the stem is one slender pole; else 0."""
    pole = 0.4  # share of the height; least length of a stem
    pole_slices = 16
    slender = 0.08  # share of a pole's length; largest spread
    own, place = share[stem], across[stem]
    length = own.max() - own.min() if len(own) else 0.0
    if length < pole:
        return 0.0
    number = np.minimum(((own - own.min()) / length * pole_slices).astype(int), pole_slices - 1)
    radii = _spreads(place, number, pole_slices)
    if radii.max() > slender * length:
        return 0.0
    return float(np.clip(np.log(max(radii[0], 1e-4) / max(radii[-1], 1e-4)), -3, 3))


def _spreads(
    across: Float64[np.ndarray, "P 2"], number: Int64[np.ndarray, " P"], count: int
) -> Float64[np.ndarray, " S"]:
    """Compute each slice's robust radius about its own middle, in which outlying twigs count little; 0 if empty."""
    size = np.maximum(np.bincount(number, minlength=count), 1)
    x, y = (column - (np.bincount(number, column, count) / size)[number] for column in across.T)
    return np.asarray(np.bincount(number, np.sqrt(x * x + y * y), count) / size)


def _material_kinds(mesh: TriangleMesh) -> Int64[np.ndarray, " F"]:
    """Classify faces by their material's name: 1 for wood, 2 for leaves, 0 for others."""
    if mesh.look.face_material is None or not mesh.look.materials:
        return np.zeros(mesh.num_faces, np.int64)
    named = [2 if LEAF.search(m.name) else 1 if WOOD.search(m.name) else 0 for m in mesh.look.materials]
    detected = set(named) - {0}
    if len(detected) == 1:  # if only one kind is named, other materials are the other kind
        named = [kind or 3 - detected.copy().pop() for kind in named]
    return np.asarray(np.array(named, np.int64)[mesh.look.face_material])


def _largest_part(mesh: TriangleMesh) -> Int64[np.ndarray, " F"]:
    """Mark the faces of the connected part with the largest extent with 1."""
    welded, _ = weld(mesh)
    part = connected_parts(welded.faces, welded.num_vertices)
    low, high = part_bounds(part, welded.vertices)
    return np.asarray(part[welded.faces[:, 0]] == np.argmax(np.linalg.norm(high - low, axis=1)), np.int64)
