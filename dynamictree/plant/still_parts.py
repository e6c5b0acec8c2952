"""Detect the parts of a mesh that are not the plant and stand still: pots, soil, tables, ground, water, stones.

A face stands still by the name of its material, node or group, or as part of a connected part of the mesh that

- is flat and wide: a plane, a patch of ground, an island, at the bottom, or higher where it is vast;
- lies low and apart: all of it in the lowest fifth of the height, away from whatever reaches higher;
- is a vessel: it stands at the bottom, is wide all the way up, and either holds named soil, or what rises out of it or
  stands on it is narrower there and just above: a trunk below a crown is no pot.

Of a part that is plant and base at once, as a mesh made from a picture is, the base stands still: see `fused_base.py`.
"""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64
from scipy.spatial import cKDTree

from dynamictree.mesh import StillPart, TriangleMesh, connected_parts, part_bounds, weld
from dynamictree.plant.fused_base import find_fused_base

STILL_NAMES = frozenset(
    " ".join(
        (
            "pot pots flowerpot plantpot vase planter soil dirt earth ground terrain table desk plate saucer dish",
            "water sea ocean lake river pond rock rocks stone stones pebble pebbles sand beach floor concrete",
            "road path pavement glass ceramic terracotta clay island plane wall fence bench topf erde boden tisch",
            "wasser stein terre",
        )
    ).split()
)
"""Words in the names of materials and nodes of what is no plant."""
_OF_SHAPES = frozenset({"plane", "plate", "island", "earth", "wall"})
"""Of nodes these are names that modelling programs give, or of a scene's root."""
SOIL_NAMES = frozenset(("soil", "dirt", "earth", "erde", "terre"))
_GROUND = StillPart(name="ground", why="flat and wide, at the bottom")
_THINGS = StillPart(name="things", why="low, and apart from what rises higher")
_POT = StillPart(name="pot", why="a vessel around the foot of what rises out of it")

_FLAT = 0.2  # height over the narrower width of what is flat
_WIDE = 0.5  # its width, of the height of what reaches higher
_VAST = 3.0  # its width where it lies up to the middle of that height
_LOW = 0.2  # of the height
_APART = 0.05  # of the height
_VESSEL_HEIGHT = 0.5  # of the whole, at most
_VESSEL_FOOT = 0.05  # of the whole: it stands at most so high
_VESSEL_WIDTH = 1.5  # over that of what it encloses
_WITH_SOIL_HEIGHT = 0.75  # of the whole, at most, of a vessel that holds soil
_SOIL_SIZE = 0.5  # of the vessel's width, and of its height, at least, so wide and so high lies soil in it
_ON_TOP = 0.01  # of the whole: what begins so near to the top stands on it
_ABOVE = (0.03, 0.06, 0.1)  # of the height of what rises: here, over the rim, it is narrower than the vessel
_SPOTS = np.array(
    [(6, 0, 0), (0, 6, 0), (0, 0, 6), (2, 2, 2), (3, 3, 0), (0, 3, 3), (3, 0, 3), (4, 1, 1), (1, 4, 1), (1, 1, 4)]
) / np.float64(6)  # barycentric
_LEAST_PLANT = 0.02  # of the faces: with less left over, nothing is taken away


@dataclass(frozen=True, kw_only=True, eq=False)
class _Parts:
    """The connected parts of a mesh, with the corners of their bounding boxes [m]."""

    mesh: TriangleMesh
    of_face: Int64[np.ndarray, " F"]
    low: Float64[np.ndarray, "parts 3"]
    high: Float64[np.ndarray, "parts 3"]

    @classmethod
    def of(cls, mesh: TriangleMesh) -> "_Parts":
        of_face = _part_of_face(mesh)
        low, high = part_bounds(np.repeat(of_face, 3), mesh.vertices[mesh.faces.ravel()])
        return cls(mesh=mesh, of_face=of_face, low=low, high=high)

    @property
    def material(self) -> Int64[np.ndarray, " parts"]:
        """Number of the material of each part; of a mesh without any, -1."""
        of_part = np.full(len(self.low), -1, np.int64)
        if self.mesh.face_material is not None:
            of_part[self.of_face] = self.mesh.face_material
        return of_part


def find_still_parts(mesh: TriangleMesh) -> tuple[tuple[StillPart, ...], Bool[np.ndarray, " F"] | None]:
    """What stands still of a mesh in metres and +Z up, and which faces; None if all of it may move."""
    named, still_parts = _named(mesh)
    parts = _Parts.of(mesh)
    gone = np.zeros(len(parts.low), np.bool_)
    gone[parts.of_face[named]] = True  # a part that is named in places is still as a whole
    for rule, detected in ((_flat, _GROUND), (_low_and_apart, _THINGS), (_vessels, _POT)):
        tried = gone | rule(parts, gone)
        if (~tried[parts.of_face]).mean() >= _LEAST_PLANT:
            still_parts += [detected] if (tried & ~gone).any() else []
            gone = tried
    still: Bool[np.ndarray, " F"] = gone[parts.of_face]
    fused = _fused(parts, gone)
    if fused is not None and (~(still | fused[1])).mean() >= _LEAST_PLANT:
        still_parts += [fused[0]]
        still |= fused[1]
    return (tuple(still_parts), still) if still.any() and not still.all() else ((), None)


def find_still_faces(mesh: TriangleMesh) -> Bool[np.ndarray, " F"] | None:
    """Which faces stand still, of a mesh in metres and +Z up; None if all of it may move."""
    return find_still_parts(mesh)[1]


def is_still_name(name: str, *, but: frozenset[str] = frozenset()) -> bool:
    """Whether a word in a name, split at capitals, digits and signs, names what is no plant; `but` do not."""
    return not _words(name).isdisjoint(STILL_NAMES - but)


def _words(name: str) -> frozenset[str]:
    return frozenset(word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name))


def _named(mesh: TriangleMesh) -> tuple[Bool[np.ndarray, " F"], list[StillPart]]:
    """Faces whose material, node or group is named as something that is no plant."""
    named, parts = np.zeros(mesh.num_faces, np.bool_), list[StillPart]()
    for owner, names, meaningless in (
        (mesh.face_material, [material.name for material in mesh.materials], frozenset[str]()),
        (mesh.face_part, list(mesh.part_names), _OF_SHAPES),
    ):
        if owner is None:
            continue
        still = np.array([is_still_name(name, but=meaningless) for name in names], np.bool_)
        if not still[owner].all():
            named |= still[owner]
            parts += [StillPart(name=names[i], why="its name") for i in np.unique(owner[still[owner]])]
    return (named, parts) if not named.all() else (np.zeros_like(named), [])


def _part_of_face(mesh: TriangleMesh) -> Int64[np.ndarray, " F"]:
    """The connected part of each face; materials split parts, so that soil in a trunk's mesh is one by itself."""
    welded, _ = weld(mesh)
    part = connected_parts(welded.faces, welded.num_vertices)[welded.faces[:, 0]].astype(np.int64)
    if mesh.face_material is not None:
        part = part * len(mesh.materials) + mesh.face_material
    detected: Int64[np.ndarray, " F"] = np.unique(part, return_inverse=True)[1].astype(np.int64).ravel()
    return detected


def _flat(parts: _Parts, gone: Bool[np.ndarray, " parts"]) -> Bool[np.ndarray, " parts"]:
    low, high = parts.low, parts.high
    extent = high - low
    narrow = extent[:, :2].min(axis=1)
    flat = extent[:, 2] < _FLAT * narrow
    rest = ~(flat | gone)
    if not rest.any():
        return np.zeros_like(flat)
    floor = low[rest, 2].min()
    height = high[rest, 2].max() - floor
    middle = (low[:, 2] + high[:, 2]) / 2 - floor
    beneath = (middle < 0.1 * height) & (narrow > _WIDE * height)
    vast = (middle < 0.5 * height) & (narrow > _VAST * height)
    detected: Bool[np.ndarray, " parts"] = flat & (beneath | vast)
    return detected


def _low_and_apart(parts: _Parts, gone: Bool[np.ndarray, " parts"]) -> Bool[np.ndarray, " parts"]:
    part, low, high = parts.of_face, parts.low, parts.high
    floor, top = low[~gone, 2].min(), high[~gone, 2].max()
    lying = ~gone & (high[:, 2] < floor + _LOW * (top - floor))
    detected = np.zeros(len(low), np.bool_)
    rising = np.flatnonzero((~lying & ~gone)[part])
    candidates = np.flatnonzero(lying[part])
    if len(candidates) == 0 or len(rising) == 0:
        return detected
    reach = _APART * (top - floor)
    while len(candidates):  # what hangs on what rises, and what hangs on that, is of the plant
        near = np.zeros(len(low), np.bool_)
        near[part[candidates[_gaps(parts.mesh, candidates, rising) <= reach]]] = True
        if not near.any():
            break
        rising, candidates = candidates[near[part[candidates]]], candidates[~near[part[candidates]]]
    detected[part[candidates]] = True
    return detected


def _gaps(
    mesh: TriangleMesh, faces: Int64[np.ndarray, " M"], others: Int64[np.ndarray, " L"]
) -> Float64[np.ndarray, " M"]:
    """Distance of the corners and middles of some faces from points on others."""
    corners = mesh.vertices[mesh.faces[others]].astype(np.float64)
    places = np.einsum("si,fic->fsc", _SPOTS, corners).reshape(-1, 3)
    own = np.einsum("si,fic->fsc", _SPOTS[:4], mesh.vertices[mesh.faces[faces]].astype(np.float64))
    distance = np.asarray(cKDTree(places).query(own.reshape(-1, 3))[0]).reshape(-1, 4)
    gaps: Float64[np.ndarray, " M"] = distance.min(axis=1)
    return gaps


def _vessels(parts: _Parts, gone: Bool[np.ndarray, " parts"]) -> Bool[np.ndarray, " parts"]:
    mesh, part, low, high = parts.mesh, parts.of_face, parts.low, parts.high
    floor, top = low[~gone, 2].min(), high[~gone, 2].max()
    height = top - floor
    stands = ~gone & (low[:, 2] < floor + _VESSEL_FOOT * height) & (high[:, 2] < floor + _WITH_SOIL_HEIGHT * height)
    soil, material = _soil(parts), parts.material
    detected = np.zeros(len(low), np.bool_)
    for one in np.flatnonzero(stands)[np.argsort(-(high - low)[stands, :2].max(axis=1))][:50]:
        width, rim = (high - low)[one, :2].min(), float(high[one, 2])
        holds = _holds(low[one], high[one], low[soil], high[soil])
        if not holds and rim > floor + _VESSEL_HEIGHT * height:
            continue
        if not holds:
            base = rim + _ON_TOP * height * (material != material[one])  # what is of one material is one thing
            rises = np.flatnonzero(~gone & (high[:, 2] > 2 * rim - low[one, 2]) & (low[:, 2] < base))
            foot = _feet(mesh, part, rises, float(base.max()))
            if foot is None or not ((foot[0] >= low[one, :2]) & (foot[1] <= high[one, :2])).all():
                continue
            above = rim + np.array(_ABOVE) * (high[rises, 2].max() - rim)
            widest = max(_width_at(mesh, np.isin(part, rises), float(level)) for level in above)
            if width <= max(_VESSEL_WIDTH * (foot[1] - foot[0]).max(), widest):
                continue
        detected[one] = _wide_all_the_way(mesh.vertices[np.unique(mesh.faces[part == one])])
    return detected


def _fused(parts: _Parts, gone: Bool[np.ndarray, " parts"]) -> tuple[StillPart, Bool[np.ndarray, " F"]] | None:
    """The base of the largest part that stands at the bottom and rises."""
    floor, top = parts.low[~gone, 2].min(), parts.high[~gone, 2].max()
    height = top - floor
    rises = ~gone & (parts.low[:, 2] < floor + _VESSEL_FOOT * height) & (parts.high[:, 2] > floor + 0.5 * height)
    if not rises.any():
        return None
    size = np.bincount(parts.of_face, minlength=len(gone)) * rises
    own = parts.of_face == int(size.argmax())
    base = find_fused_base(TriangleMesh(vertices=parts.mesh.vertices, faces=parts.mesh.faces[own]))
    if base is None:
        return None
    still = np.zeros(parts.mesh.num_faces, np.bool_)
    still[own] = base[1]
    return base[0], still


def _soil(parts: _Parts) -> Int64[np.ndarray, " M"]:
    """Parts whose material is named as soil."""
    named = [not SOIL_NAMES.isdisjoint(_words(material.name)) for material in parts.mesh.materials]
    return np.flatnonzero(np.array([*named, False])[parts.material])


def _holds(
    low: Float64[np.ndarray, "3"],
    high: Float64[np.ndarray, "3"],
    inner_low: Float64[np.ndarray, "M 3"],
    inner_high: Float64[np.ndarray, "M 3"],
) -> bool:
    """Whether a box has, in its upper half, one of others in it that is about as wide."""
    extent, slack = high - low, 0.1 * (high - low)
    inside = ((inner_low >= low - slack) & (inner_high <= high + slack)).all(axis=1)
    lies_high = (inner_low + inner_high)[:, 2] / 2 > low[2] + _SOIL_SIZE * extent[2]
    wide = ((inner_high - inner_low)[:, :2] > _SOIL_SIZE * extent[:2]).all(axis=1)
    return bool((inside & lies_high & wide).any())


def _width_at(mesh: TriangleMesh, rows: Bool[np.ndarray, " F"], level: float) -> float:
    """The longer side, seen from above, of the cut of some faces at a height, without outlying twigs."""
    corners = mesh.vertices[mesh.faces[rows]].astype(np.float64)
    start, end = corners.reshape(-1, 3), np.roll(corners, -1, axis=1).reshape(-1, 3)
    cut = (start[:, 2] < level) != (end[:, 2] < level)
    start, end = start[cut], end[cut]
    if len(start) == 0:
        return 0.0
    places = start + (end - start) * ((level - start[:, 2]) / (end - start)[:, 2])[:, None]
    low, high = np.quantile(places[:, :2], [0.1, 0.9], axis=0)
    return float((high - low).max())


def _feet(
    mesh: TriangleMesh, part: Int64[np.ndarray, " F"], parts: Int64[np.ndarray, " M"], below: float
) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "2"]] | None:
    """Low and high corner, seen from above, of the corners of some parts that lie below a height."""
    corners = mesh.vertices[np.unique(mesh.faces[np.isin(part, parts)])].astype(np.float64)
    corners = corners[corners[:, 2] <= below]
    return (corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)) if len(corners) else None


def _wide_all_the_way(points: Float32[np.ndarray, "P 3"]) -> bool:
    """Whether its outline is wide at every one of four heights, as a pot's is and a branching stem's is not."""
    share = (points[:, 2] - points[:, 2].min()) / max(float(np.ptp(points[:, 2])), 1e-12)
    away = np.linalg.norm(points[:, :2] - points[:, :2].mean(axis=0), axis=1)
    ends = [away[share < 0.25].max(initial=0), away[share > 0.75].max(initial=0)]
    return bool(min(ends) > 0.4 * away.max())
