"""Levels of detail of a moving tree: fewer triangles, the same motion; last, cards with a picture of the tree.

Wood is simplified; its vertices are vertices of the source, with their texture coordinates and motion. Leaves are
thinned; the remaining ones grow about their attachment so that the total area stays the same, and move as before.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex64, Float32, Int32, Int64

from dynamictree.export.cards import cards_of
from dynamictree.export.moving_tree import Report
from dynamictree.gaussian.binding import nearest_on_faces, solid_faces
from dynamictree.mesh import MeshLook, TriangleMesh, connected_parts, part_bounds, weld
from dynamictree.render.appearance import foliage_faces, is_leafy
from dynamictree.spectrum import iter_motion
from dynamictree.voxel.grid import morton_order

SHARES = (1.0, 0.4, 0.15, 0.05)
"""Share of the triangles, by level."""
_SPLITS = 4  # vertices at one place, at seams of the texture, that are tried for a corner


@dataclass(frozen=True, kw_only=True)
class LevelError:
    """Error of a level against the tree, over all of the tree's vertices and frames."""

    num_triangles: int
    num_vertices: int
    relative_error: float  # root mean square of the error over that of the motion
    rms_error_m: float
    max_error_m: float


@dataclass(frozen=True, kw_only=True)
class Level:
    """One level of detail: a mesh, the spectrum of its vertices [m], and its error."""

    mesh: TriangleMesh
    coefficients: Complex64[np.ndarray, "N K 3"]
    error: LevelError


def levels_of(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    num_frames: int,
    on_progress: Report = lambda done: None,
) -> list[Level]:
    """Return levels with `SHARES` of the triangles, and cards.

    `on_progress` receives the completed share; its exceptions propagate.
    """
    leaves = _leaf_parts(mesh)
    meshes = [(mesh, coefficients)]
    for number, share in enumerate(SHARES[1:]):
        on_progress(number / (2 * len(SHARES)))
        meshes.append(_reduced(mesh, coefficients, leaves, share))
    meshes.append(cards_of(mesh, coefficients))
    levels = []
    for number, (level, motion) in enumerate(meshes):
        on_progress((1 + number / len(meshes)) / 2)
        relative, rms, largest = motion_error(mesh, coefficients, level, motion, num_frames)
        error = LevelError(
            num_triangles=level.num_faces,
            num_vertices=level.num_vertices,
            relative_error=relative,
            rms_error_m=rms,
            max_error_m=largest,
        )
        levels.append(Level(mesh=level, coefficients=motion, error=error))
    return levels


def motion_error(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    level: TriangleMesh,
    motion: Complex64[np.ndarray, "M K 3"],
    num_frames: int,
) -> tuple[float, float, float]:
    """Return the error of a level's motion: relative, root mean square [m] and largest [m].

    Each vertex of the tree's faces is compared with the point of the level's surface that is nearest to it at rest.
    """
    if level is mesh:
        return 0.0, 0.0, 0.0
    used, faces = np.unique(mesh.faces), solid_faces(level)
    _, face, weights = nearest_on_faces(mesh.vertices[used], level.vertices, faces)
    corners = faces[face]
    phases = np.arange(num_frames) / num_frames
    total = missing = most = 0.0
    for truth, moved in zip(
        iter_motion(coefficients, phases, num_frames), iter_motion(motion, phases, num_frames), strict=True
    ):
        gap = ((np.einsum("pc,pcx->px", weights, moved[corners]) - truth[used]) ** 2).sum(axis=1)
        total, missing = total + float((truth[used] ** 2).sum()), missing + float(gap.sum())
        most = max(most, float(gap.max()))
    relative = float(np.sqrt(missing / total)) if total > 0 else 0.0
    return relative, float(np.sqrt(missing / (num_frames * len(used)))), float(np.sqrt(most))


def wood_vertices(mesh: TriangleMesh) -> Bool[np.ndarray, " N"]:
    """Mask of the vertices that are not of leaves: trunk, branches, and crowns that are one surface."""
    wood = np.zeros(mesh.num_vertices, np.bool_)
    wood[mesh.faces[_leaf_parts(mesh) < 0]] = True
    return np.asarray(wood & ~mesh.still_vertices)


def _leaf_parts(mesh: TriangleMesh) -> Int64[np.ndarray, " F"]:
    """Label each face with the index of its leaf, in Morton order; -1 for wood."""
    fewest_leaves = 16  # fewer small pieces are no foliage, but a pot or a trunk of few faces
    surface, _ = weld(mesh)
    part = connected_parts(surface.faces, surface.num_vertices)[surface.faces[:, 0]]
    leaf = foliage_faces(surface.faces, surface.num_vertices)
    leafy = np.array([is_leafy(material) for material in mesh.look.materials])
    if leafy.any():
        leaf &= leafy[mesh.material_of_face]
    if mesh.still_faces is not None:
        leaf &= ~mesh.still_faces
    numbers, own = np.unique(part[leaf], return_inverse=True)
    if len(numbers) < fewest_leaves:
        return np.full(mesh.num_faces, -1)
    centre = (
        np.stack([np.bincount(own, mesh.vertices[mesh.faces[leaf]].mean(axis=1)[:, axis]) for axis in range(3)], axis=1)
        / np.bincount(own)[:, None]
    )
    rank = np.empty(len(numbers), np.int64)
    extent = np.maximum(np.ptp(centre, axis=0), 1e-9)
    cells = np.floor((centre - centre.min(axis=0)) / extent * 1023).astype(np.int64)
    rank[morton_order(cells)] = np.arange(len(numbers))
    result = np.full(mesh.num_faces, -1)
    result[leaf] = rank[own]
    return result


def _reduced(
    mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"], leaves: Int64[np.ndarray, " F"], share: float
) -> tuple[TriangleMesh, Complex64[np.ndarray, "M K 3"]]:
    """Reduce a mesh to a share of its triangles: simplify wood per material, and thin leaves."""
    stays = np.isin(leaves, _typical_leaves(mesh, coefficients, leaves, share))
    faces, materials = [mesh.faces[stays]], [mesh.material_of_face[stays]]
    for number in np.unique(mesh.material_of_face[leaves < 0]).tolist():
        faces.append(_simplified(mesh, mesh.faces[(leaves < 0) & (mesh.material_of_face == number)], share))
        materials.append(np.full(len(faces[-1]), number, np.int32))
    vertices = _enlarge_leaves(mesh, leaves, stays)
    used, corners = np.unique(np.concatenate(faces), return_inverse=True)
    level = TriangleMesh(
        vertices=vertices[used],
        faces=corners.reshape(-1, 3).astype(np.int32),
        look=MeshLook(
            uv=None if mesh.look.uv is None else mesh.look.uv[used],
            vertex_colors=None if mesh.look.vertex_colors is None else mesh.look.vertex_colors[used],
            face_material=np.concatenate(materials) if mesh.look.materials else None,
            materials=mesh.look.materials,
        ),
    )
    return level, coefficients[used]


def _typical_leaves(
    mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"], leaves: Int64[np.ndarray, " F"], share: float
) -> Int64[np.ndarray, " S"]:
    """Return, for each group of neighbouring leaves, the one with the motion nearest to the group's mean."""
    face = np.flatnonzero(leaves >= 0)
    if not len(face):
        return face
    _, first = np.unique(leaves[face], return_index=True)
    motion = coefficients[mesh.faces[face[first]]].mean(axis=1).reshape(len(first), -1)  # [L, 3K]
    group = np.floor(np.arange(len(first)) * share).astype(np.int64)
    mean = np.stack([motion[group == number].mean(axis=0) for number in range(group[-1] + 1)])
    apart = np.linalg.norm(motion - mean[group], axis=1)
    order = np.lexsort((apart, group))
    return np.asarray(order[np.unique(group[order], return_index=True)[1]])


def _simplified(mesh: TriangleMesh, faces: Int32[np.ndarray, "F 3"], share: float) -> Int32[np.ndarray, "S 3"]:
    """Simplify faces by quadric error; each new vertex is replaced by the nearest old one."""
    branch_share = 1.4  # ratio by which quadrics can reduce thin branches; beyond it they reduce the trunk
    fewest_faces = 100  # least number of wood faces per material
    import fast_simplification
    from scipy.spatial import cKDTree

    own = np.unique(faces)
    places, place = np.unique(mesh.vertices[own], axis=0, return_inverse=True)
    corners = place.ravel()[np.searchsorted(own, faces)].astype(np.int32)
    target = max(round(share * len(faces)), fewest_faces)
    if target >= len(faces):
        return faces
    thick = _thickest(places, corners, round(branch_share * target))
    target = max(target, round(len(thick) / branch_share) if len(thick) < len(corners) else 0)
    points, fewer = fast_simplification.simplify(*_close_ends(places, thick), target_count=target)
    a, b, c = np.asarray(cKDTree(places).query(points)[1])[fewer].reshape(-1, 3).T
    return _corners_at(mesh, own, place.ravel(), np.column_stack([a, b, c])[(a != b) & (b != c) & (c != a)])


def _thickest(
    places: Float32[np.ndarray, "P 3"], faces: Int32[np.ndarray, "F 3"], count: int
) -> Int32[np.ndarray, "S 3"]:
    """Return about `count` faces, of the thickest branches, if branches are separate parts; else all faces."""
    fewest_branches = 16  # separate parts; if there are fewer, none is left out
    part = connected_parts(faces, len(places))[faces[:, 0]]
    if len(np.unique(part)) < fewest_branches:
        return faces
    corners = places[faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    low, high = part_bounds(np.repeat(part, 3), corners.reshape(-1, 3).astype(np.float32))
    thickness = np.bincount(part, area) / np.maximum(np.linalg.norm(high - low, axis=1), 1e-9)
    order = np.argsort(-thickness[part], kind="stable")
    last = part[order[min(count, len(order)) - 1]]
    return np.asarray(faces[thickness[part] >= thickness[last]])


def _close_ends(
    places: Float32[np.ndarray, "P 3"], faces: Int32[np.ndarray, "F 3"]
) -> tuple[Float32[np.ndarray, "Q 3"], Int32[np.ndarray, "G 3"]]:
    """Close the open ends of branches, whose rims could not be simplified."""
    longest_rim = 24  # edges around the open end of a branch
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    keys, reverse = edges[:, 0] * len(places) + edges[:, 1], edges[:, 1] * len(places) + edges[:, 0]
    rim = edges[~np.isin(keys, reverse)]
    shape = (len(places), len(places))
    _, loop = connected_components(coo_array((np.ones(len(rim)), rim.T), shape=shape), directed=False)
    length = np.bincount(loop[rim[:, 0]], minlength=int(loop.max()) + 1)
    rim = rim[length[loop[rim[:, 0]]] <= longest_rim]
    ends, end = np.unique(loop[rim[:, 0]], return_inverse=True)
    if not len(ends):
        return places, faces
    total = np.stack([np.bincount(end, places[rim[:, 0], axis]) for axis in range(3)], axis=1)
    middle = (total / np.bincount(end)[:, None]).astype(np.float32)
    caps = np.column_stack([rim[:, 1], rim[:, 0], len(places) + end])
    return np.concatenate([places, middle]), np.concatenate([faces, caps.astype(np.int32)])


def _corners_at(
    mesh: TriangleMesh, own: Int32[np.ndarray, " n"], place: Int64[np.ndarray, " n"], faces: Int64[np.ndarray, "S 3"]
) -> Int32[np.ndarray, "S 3"]:
    """Choose the vertices of faces of places: of several at one place, those nearest to each other on the texture."""
    order = np.argsort(place, kind="stable")
    first = np.searchsorted(place[order], np.arange(int(place.max()) + 1))
    count = np.diff(np.append(first, len(order)))
    choices = own[order[first[:, None] + np.minimum(np.arange(_SPLITS), count[:, None] - 1)]]  # [P, _SPLITS]
    if mesh.look.uv is None:
        return np.asarray(choices[faces, 0].astype(np.int32))
    best = np.full(len(faces), np.inf)
    chosen = choices[faces, 0].astype(np.int32)
    for splits in np.ndindex(_SPLITS, _SPLITS, _SPLITS):
        trial = np.stack([choices[faces[:, corner], split] for corner, split in enumerate(splits)], axis=1)
        uv = mesh.look.uv[trial]
        spread = sum(((uv[:, a] - uv[:, b]) ** 2).sum(axis=1) for a, b in ((0, 1), (1, 2), (2, 0)))
        better = spread < best
        best[better], chosen[better] = spread[better], trial[better]
    return np.asarray(chosen)


def _enlarge_leaves(
    mesh: TriangleMesh, leaves: Int64[np.ndarray, " F"], stays: Bool[np.ndarray, " F"]
) -> Float32[np.ndarray, "N 3"]:
    """Return the vertices, with remaining leaves enlarged about their vertex that is nearest to the wood."""
    largest_growth = 4.0  # limit of a leaf's enlargement; a level of very few leaves has less area than the tree
    from scipy.spatial import cKDTree

    vertices = mesh.vertices.copy()
    if not stays.any():
        return vertices
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    growth = min(float(np.sqrt(area[leaves >= 0].sum() / max(area[stays].sum(), 1e-12))), largest_growth)
    leaf = np.full(mesh.num_vertices, -1)
    leaf[mesh.faces[stays]] = leaves[stays][:, None]
    own = np.flatnonzero(leaf >= 0)
    wood = np.unique(mesh.faces[leaves < 0])
    gap = cKDTree(mesh.vertices[wood]).query(mesh.vertices[own])[0] if len(wood) else mesh.vertices[own, 2]
    order = own[np.lexsort((np.asarray(gap), leaf[own]))]
    numbers, first = np.unique(leaf[order], return_index=True)
    attached = order[first][np.searchsorted(numbers, leaf[own])]
    vertices[own] += np.float32(growth - 1) * (mesh.vertices[own] - mesh.vertices[attached])
    return vertices
