"""Find the base that is one surface with its plant, as of meshes made from pictures: a plate, ground or a pot.

Connected parts cannot tell it, so points of the surface are judged by the rules for clouds, which no trunk, root or
stem meets: a plate has a level top below the plant, wide and filled; a pot is a closed wall at the bottom with a level
layer in it.
"""

import numpy as np
from jaxtyping import Bool

from dynamictree.mesh import StillPart, TriangleMesh, connected_parts, part_bounds, weld
from dynamictree.plant.ground import find_ground
from dynamictree.plant.pot import find_pot, in_pot
from dynamictree.plant.still_gaussians import height_of

PLATE = StillPart(name="ground", why="a level base of one surface with the plant")
POT = StillPart(name="pot", why="a closed wall at the bottom, filled with soil, of one surface with the plant")
_POINTS = 150_000
_UPWARD = 0.5  # of a normal, along +Z
_SOIL_SEEN = 0.7  # of a pot's inside: below stems of one surface with it there is none
_LOWEST, _PLATE_TOP, _POT_TOP = 0.02, 0.15, 0.65
"""Of the height: a base reaches up so far at least, a plate and a pot so far at most."""


def find_fused_base(mesh: TriangleMesh) -> tuple[StillPart, Bool[np.ndarray, " F"]] | None:
    """Which faces of a connected surface in metres and +Z up are a base, not the plant; None without one."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    if not area.sum() > 0:
        return None
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), _POINTS, p=area / area.sum())
    points = np.einsum("pi,pic->pc", rng.dirichlet(np.ones(3), _POINTS), corners[face])
    height_m = height_of(points)
    if not height_m > 0:
        return None
    inside_out = np.einsum("fi,fi->", corners.mean(axis=1) - corners.mean(axis=(0, 1)), across) < 0
    upward = (-across if inside_out else across)[face, 2] > _UPWARD * area[face]
    places = mesh.vertices.astype(np.float64)
    plane = find_ground(points[upward], height_m, rng) if upward.any() else None
    if plane is not None:
        base = _with_what_is_cut_off(mesh, places @ np.array([-plane[0], -plane[1], 1.0]) <= plane[2], _PLATE_TOP)
        if base is not None:
            return PLATE, base
    pot = find_pot(points, height_m, rng, soil_seen=_SOIL_SEEN, upward=upward)
    base = None if pot is None else _with_what_is_cut_off(mesh, in_pot(pot, places), _POT_TOP)
    return None if base is None else (POT, base)


def _with_what_is_cut_off(
    mesh: TriangleMesh, inside: Bool[np.ndarray, " N"], highest: float
) -> Bool[np.ndarray, " F"] | None:
    """Faces of a base with the pieces, such as of a rim, that hang on it alone; None if it is no base below a plant."""
    base = inside[mesh.faces].all(axis=1)
    welded, _ = weld(mesh)
    piece = connected_parts(welded.faces[~base], welded.num_vertices)
    _, high = part_bounds(piece, welded.vertices)
    floor, height = welded.vertices[:, 2].min(), float(np.ptp(welded.vertices[:, 2]))
    rises = high[piece[welded.faces[:, 0]], 2] > floor + highest * height
    still = base | ~rises
    if still.all() or not still.any():
        return None
    top = welded.vertices[welded.faces[still], 2].max() - floor
    return still if _LOWEST * height < top < highest * height else None
