"""Detect the still parts of a mesh, by names and by points on its surface.

Names of materials, nodes and groups count unless the rest would be no plant by its shape, such as a pot whose plant is
named `Path`. A base that forms one surface with its plant, as in meshes generated from pictures, is detected by the
rules for clouds.
"""

import numpy as np
from jaxtyping import Bool, Int64

from dynamictree.mesh import StillPart, TriangleMesh, connected_parts, part_bounds, weld
from dynamictree.plant.ground import find_ground
from dynamictree.plant.names import OF_SHAPES, SOIL_NAMES, is_still_name, words
from dynamictree.plant.pot import find_pot, in_pot
from dynamictree.plant.sample import face_areas, face_normals, on_faces, surface_points
from dynamictree.plant.still import (
    BOARDS,
    FOOT,
    GROUND,
    LEAST_PLANT,
    POT,
    THINGS,
    Scene,
    ThingMask,
    find_boards,
    find_low_things,
    find_planes,
    find_vessels,
    height_of,
)

_LOWEST, _PLATE_TOP, _POT_TOP = 0.02, 0.15, 0.65
"""Least top of a base, and largest top of a plate and of a pot [share of the height]."""

Faces = Bool[np.ndarray, " F"]


def find_still_parts(mesh: TriangleMesh) -> tuple[tuple[StillPart, ...], Faces | None]:
    """Detect the still parts of a mesh [m, +Z up]; return them and a mask of their faces, None if all may move."""
    of_face = _part_of_face(mesh)
    scene = _scene(mesh, of_face)
    named, parts = _named(mesh)
    gone = np.zeros(len(scene.low), np.bool_)
    gone[of_face[named]] = True  # if some faces of a part are named, all of it is still
    if named.any():
        detected, by_shape = _by_shape(scene, np.zeros_like(gone), of_face)
        if by_shape[of_face[~named]].all():
            gone, parts = by_shape, detected
    detected, gone = _by_shape(scene, gone, of_face)
    parts += [part for part in detected if part not in parts]
    still: Faces = gone[of_face]
    fused = _fused_base(mesh, scene, gone, of_face)
    if fused is not None and (~(still | fused[1])).mean() >= LEAST_PLANT:
        parts += [part for part in fused[:1] if part not in parts]
        still |= fused[1]
    return (tuple(parts), still) if still.any() and not still.all() else ((), None)


def _by_shape(scene: Scene, gone: ThingMask, of_face: Int64[np.ndarray, " F"]) -> tuple[list[StillPart], ThingMask]:
    parts = []
    for rule, part in ((find_planes, GROUND), (find_boards, BOARDS), (find_low_things, THINGS), (find_vessels, POT)):
        tried = gone | rule(scene, gone)
        if (tried & ~gone).any() and (~tried[of_face]).mean() >= LEAST_PLANT:
            parts.append(part)
            gone = tried
    return parts, gone


def _named(mesh: TriangleMesh) -> tuple[Faces, list[StillPart]]:
    """Find the faces whose material, node or group has the name of an object that is no plant."""
    named, parts = np.zeros(mesh.num_faces, np.bool_), list[StillPart]()
    for owner, names, meaningless in (
        (mesh.look.face_material, [material.name for material in mesh.look.materials], frozenset[str]()),
        (mesh.parts.of_face, list(mesh.parts.names), OF_SHAPES),
    ):
        if owner is None:
            continue
        still = np.array([is_still_name(name, but=meaningless) for name in names], np.bool_)
        if not still[owner].all():
            named |= still[owner]
            parts += [StillPart(name=names[i], why="its name") for i in np.unique(owner[still[owner]])]
    return (named, parts) if not named.all() else (np.zeros_like(named), [])


def _part_of_face(mesh: TriangleMesh) -> Int64[np.ndarray, " F"]:
    """Label the connected part of each face; materials split parts, so that soil connected with a trunk is separate."""
    welded, _ = weld(mesh)
    part = connected_parts(welded.faces, welded.num_vertices)[welded.faces[:, 0]].astype(np.int64)
    if mesh.look.face_material is not None:
        part = part * len(mesh.look.materials) + mesh.look.face_material
    detected: Int64[np.ndarray, " F"] = np.unique(part, return_inverse=True)[1].astype(np.int64).ravel()
    return detected


def _scene(mesh: TriangleMesh, of_face: Int64[np.ndarray, " F"]) -> Scene:
    """Sample points on all faces, on a part in proportion to the root of its area, so that no water plane dominates."""
    num_points = 60_000
    area = face_areas(mesh)
    of_part = np.bincount(of_face, area)
    share = area / np.sqrt(np.maximum(of_part, 1e-30))[of_face]
    points, face = on_faces(mesh, 1 + (num_points * share / max(float(share.sum()), 1e-30)).astype(np.int64))
    low, high = part_bounds(np.repeat(of_face, 3), mesh.vertices[mesh.faces.ravel()])
    normals = face_normals(mesh) / np.maximum(2 * area, 1e-30)[:, None]
    material = np.full(len(of_part), -1, np.int64)
    if mesh.look.face_material is not None:
        material[of_face] = mesh.look.face_material
    soil = np.array([*(not SOIL_NAMES.isdisjoint(words(one.name)) for one in mesh.look.materials), False])
    return Scene(
        points=points,
        thing=of_face[face],
        normals=normals[face],
        low=low,
        high=high,
        material=material,
        soil=soil[material],
    )


def _fused_base(
    mesh: TriangleMesh, scene: Scene, gone: ThingMask, of_face: Int64[np.ndarray, " F"]
) -> tuple[StillPart, Faces] | None:
    """Find the base of the largest part that rises from the bottom: a plate, ground or a pot; None without one."""
    points_of_base = 150_000
    soil_seen = 0.7  # share of a pot's inside; there is no soil under stems connected with it
    floor, height = scene.floor_and_height(gone)
    rises = ~gone & (scene.low[:, 2] < floor + FOOT * height) & (scene.high[:, 2] > floor + 0.5 * height)
    if not rises.any():
        return None
    own = of_face == int((np.bincount(of_face, minlength=len(gone)) * rises).argmax())
    part = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[own])
    sampled = surface_points(part, points_of_base)
    if sampled is None:
        return None
    points, face = sampled
    height_m = height_of(points)
    if not height_m > 0:
        return None
    rng = np.random.default_rng(0)
    normals, middles = face_normals(part), part.vertices[part.faces].mean(axis=1, dtype=np.float64)
    inside_out = np.einsum("fi,fi->", middles - middles.mean(axis=0), normals) < 0
    length = np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    rise = ((-normals if inside_out else normals)[:, 2] / length)[face]
    upward = points[rise > 0.5]  # angle to +Z below 60°
    places = part.vertices.astype(np.float64)
    plane = find_ground(upward, height_m, rng) if len(upward) else None
    base = None if plane is None else _with_what_is_cut_off(part, plane.above(places) <= 0, _PLATE_TOP)
    detected = POT if base is None else GROUND
    if base is None:
        pot = find_pot(points, height_m, rng, soil_seen=soil_seen, rise=rise)
        base = None if pot is None else _with_what_is_cut_off(part, in_pot(pot, places), _POT_TOP)
    if base is None:
        return None
    own[own] = base
    return detected, own


def _with_what_is_cut_off(mesh: TriangleMesh, inside: Bool[np.ndarray, " N"], highest: float) -> Faces | None:
    """Extend a base by pieces connected only with it, such as a rim; None if it is no base below a plant."""
    rim = 0.05  # share of the height; pieces that reach higher above the base are stems or leaves
    base = inside[mesh.faces].all(axis=1)
    welded, _ = weld(mesh)
    piece = connected_parts(welded.faces[~base], welded.num_vertices)
    _, high = part_bounds(piece, welded.vertices)
    used = welded.vertices[np.unique(welded.faces), 2]
    floor, height = used.min(), float(np.ptp(used))
    top = welded.vertices[welded.faces[base], 2].max(initial=floor)
    rises = high[piece[welded.faces[:, 0]], 2] > top + rim * height
    still = base | ~rises
    if still.all() or not still.any():
        return None
    top = welded.vertices[welded.faces[still], 2].max() - floor
    return still if _LOWEST * height < top < highest * height else None
