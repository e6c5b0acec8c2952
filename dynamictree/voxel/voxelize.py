"""Voxelize the surface of a mesh, and average vertex values over the surface in each voxel. Paper section 3.3."""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse
from jaxtyping import Float32, Float64, Int32, Int64

from dynamictree.errors import InputError, MeshError
from dynamictree.mesh import Surface
from dynamictree.source import UNKNOWN, Source
from dynamictree.voxel.clip_kernel import SurfacePieces, cut_faces
from dynamictree.voxel.grid import VoxelGrid, grid_frame
from dynamictree.voxel.moments import moments_of

MIN_RESOLUTION, MAX_RESOLUTION = 32, 512
MAX_PIECES = 30_000_000
"""Limit of pieces of faces: 3 GB at 100 bytes each, measured. The largest meshes have 10 million at 512³."""

_MIN_AREA = 1e-16
"""Share of the area of the cube's face; smaller pieces are rounding errors of faces that touch the voxel."""

_MIN_NORMAL = 0.2
"""Length of the mean unit normal below which a voxel's surface is two-sided, such as a leaf card with a back."""


@dataclass(frozen=True, kw_only=True)
class SurfaceVoxels:
    """Voxelized surface of a tree: occupied voxels, normals and moments."""

    grid: VoxelGrid
    normals: Float32[np.ndarray, "V 3"]  # unit normals
    moments: Float32[np.ndarray, "V 16"] | None = None  # see `voxel.moments`; None without a mesh
    tree: Int32[np.ndarray, " V"] | None = None  # number of the tree, from 0; None for one tree
    source: Source = field(default_factory=Source)


def voxelize(mesh: Surface, resolution: int = 128, *, source: Source = UNKNOWN) -> SurfaceVoxels:
    """Find the voxels that contain a piece of the surface, with the mean normal in each.

    A voxel is half-open: points in the plane between two belong to the upper one. If the two sides of a thin card
    cancel in the mean, the normal is the principal axis of the normals, pointing away from the tree's centre.

    Args:
        mesh: mesh with finite vertices; faces without area are ignored.
        resolution: number of voxels along the cube's edge, 32 to 512.
        source: source of the mesh, to be recorded.

    Raises:
        InputError: the resolution is out of range.
        MeshError: the mesh has no surface, or more pieces than `MAX_PIECES`.
    """
    if not MIN_RESOLUTION <= resolution <= MAX_RESOLUTION:
        raise InputError(f"the resolution is {resolution}; {MIN_RESOLUTION} to {MAX_RESOLUTION} are allowed")
    mesh = mesh.moving_part
    if mesh.num_faces == 0:
        raise MeshError("the mesh has no faces; at least 1 triangle is needed")
    origin_m, voxel_size_m = grid_frame(mesh.vertices[np.unique(mesh.faces)], resolution)
    if voxel_size_m <= 0:
        raise MeshError("all faces lie in one point; the mesh needs an extent")
    pieces = surface_pieces(mesh, origin_m, voxel_size_m, resolution)
    keys, rows = np.unique(pieces.keys, return_inverse=True)
    coords = np.stack([keys // resolution**2, keys // resolution % resolution, keys % resolution], axis=1)
    grid = VoxelGrid(
        coords=coords.astype(np.int32), origin_m=origin_m, voxel_size_m=voxel_size_m, resolution=resolution
    )
    normals, moments = _mean_normals(mesh, grid, pieces, rows), moments_of(mesh, grid, pieces, rows)
    tree = None if mesh.face_tree is None else _largest_share(mesh.face_tree, pieces, rows, len(grid))
    return SurfaceVoxels(grid=grid, normals=normals, moments=moments, tree=tree, source=source)


def voxel_trees(mesh: Surface, grid: VoxelGrid) -> Int32[np.ndarray, " V"]:
    """Return the tree with most of the surface in each voxel; -1 for voxels without surface."""
    mesh = mesh.moving_part
    assert mesh.face_tree is not None
    pieces, rows = _pieces_in(mesh, grid)
    return _largest_share(mesh.face_tree, pieces, rows, len(grid))


def _largest_share(
    face_tree: Int32[np.ndarray, " F"], pieces: SurfacePieces, rows: Int64[np.ndarray, " P"], num_voxels: int
) -> Int32[np.ndarray, " V"]:
    num_trees = int(face_tree.max()) + 1
    keys, group = np.unique(rows * num_trees + face_tree[pieces.faces], return_inverse=True)
    area = np.bincount(group, pieces.areas)
    order = np.lexsort((area, keys // num_trees))  # the last row of each voxel has the largest area
    trees = np.full(num_voxels, -1, np.int32)
    trees[keys[order] // num_trees] = keys[order] % num_trees
    return trees


def surface_moments(mesh: Surface, grid: VoxelGrid) -> Float32[np.ndarray, "V 16"]:
    """Compute the moments that `voxelize` returns for the grid's own mesh."""
    return moments_of(mesh, grid, *_pieces_in(mesh, grid))


def surface_average(mesh: Surface, grid: VoxelGrid) -> scipy.sparse.csr_array:
    """Compute weights [V, N] that average vertex values over the surface in each voxel; rows sum to 1.

    They are exact for values that are linear on each face. Paper appendix A averages the vertices in a voxel instead,
    which leaves voxels inside large faces without a value.

    Raises:
        InputError: a voxel of the grid contains no surface of the mesh.
    """
    pieces, rows = _pieces_in(mesh, grid)
    rows = np.repeat(rows, 3)
    columns = mesh.faces[pieces.faces].ravel()
    weights = (pieces.areas[:, None] * pieces.centroids).ravel()
    total = np.bincount(rows, weights, minlength=len(grid))
    if (total <= 0).any():
        row = int(np.argmin(total))
        raise InputError(
            f"voxel {grid.coords[row].tolist()} holds none of the mesh's surface; voxelize this mesh to get its grid"
        )
    average = scipy.sparse.coo_array((weights / total[rows], (rows, columns)), shape=(len(grid), mesh.num_vertices))
    return average.tocsr().astype(np.float32)


def _pieces_in(mesh: Surface, grid: VoxelGrid) -> tuple[SurfacePieces, Int64[np.ndarray, " P"]]:
    """Return the pieces of faces in the occupied voxels of a grid, and each piece's row."""
    pieces, keys = surface_pieces(mesh, grid.origin_m, grid.voxel_size_m, grid.resolution), grid.keys
    rows = np.minimum(np.searchsorted(keys, pieces.keys), len(keys) - 1)
    there = keys[rows] == pieces.keys
    return SurfacePieces(**{name: part[there] for name, part in vars(pieces).items()}), rows[there]


def surface_pieces(
    mesh: Surface, origin_m: tuple[float, float, float], voxel_size_m: float, resolution: int
) -> SurfacePieces:
    """Return pieces of faces in voxels, plus each corner of a face as a piece with the least area."""
    in_voxels = (mesh.vertices.astype(np.float64) - origin_m) / voxel_size_m  # [N, 3]
    corners = in_voxels[mesh.faces]  # [F, 3, 3]
    inside = ((corners >= 0) & (corners < resolution)).all(axis=(1, 2))
    if len(inside) and not inside.any():
        used = mesh.vertices[np.unique(mesh.faces)].astype(np.float64)
        low, high, far = used.min(axis=0), used.max(axis=0), np.add(origin_m, resolution * voxel_size_m)
        raise MeshError(
            f"the mesh extends from {low.round(2).tolist()} to {high.round(2).tolist()} m, and the tree lies between "
            f"{np.round(origin_m, 2).tolist()} and {far.round(2).tolist()} m; take the mesh of this tree, with the "
            "same up axis and unit"
        )
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    solid = np.flatnonzero(inside & (doubled > 2 * _MIN_AREA * resolution**2))
    if len(solid) == 0:
        raise MeshError("no face of the mesh has an area inside the grid; they are lines or points")
    corners = corners[solid]
    _refuse_too_much(corners)
    pieces = cut_faces(corners, resolution)
    least = _MIN_AREA * resolution**2
    large = pieces.areas > least
    x, y, z = np.floor(corners).astype(np.int64).reshape(-1, 3).T
    corner_keys: Int64[np.ndarray, " C"] = (x * resolution + y) * resolution + z
    return SurfacePieces(
        keys=np.concatenate([pieces.keys[large], corner_keys]),
        faces=np.concatenate([solid[pieces.faces[large]], np.repeat(solid, 3)]).astype(np.int32),
        areas=np.concatenate([pieces.areas[large], np.full(len(corner_keys), least)]),
        centroids=np.concatenate([pieces.centroids[large], np.tile(np.eye(3, dtype=np.float32), (len(solid), 1))]),
    )


def _refuse_too_much(corners: Float64[np.ndarray, "F 3 3"]) -> None:
    """Bound the number of pieces by area and extent before they are computed."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    extent = np.ptp(corners, axis=1).sum()
    expected = 1.5 * area + extent + len(corners)  # a plane in general position meets 1.5 voxels per squared voxel
    if expected > MAX_PIECES:
        raise MeshError(
            f"the faces would be cut into about {expected:.2g} pieces; at most {MAX_PIECES:.2g} are allowed; take a "
            "lower resolution, or a mesh whose large faces do not lie on top of one another"
        )


def _mean_normals(
    mesh: Surface, grid: VoxelGrid, pieces: SurfacePieces, rows: Int64[np.ndarray, " P"]
) -> Float32[np.ndarray, "V 3"]:
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    unit = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    normals = unit[pieces.faces]  # [P, 3]
    num_voxels = len(grid)
    total = np.bincount(rows, pieces.areas, minlength=num_voxels)
    mean = np.stack([np.bincount(rows, pieces.areas * normals[:, i], num_voxels) for i in range(3)], axis=1)
    length = np.linalg.norm(mean, axis=1) / total
    two_sided = np.flatnonzero(length < _MIN_NORMAL)
    if len(two_sided):
        mean[two_sided] = _shared_direction(grid, pieces, rows, normals, two_sided)
    return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True), np.float32)


def _shared_direction(
    grid: VoxelGrid,
    pieces: SurfacePieces,
    rows: Int64[np.ndarray, " P"],
    normals: Float64[np.ndarray, "P 3"],
    voxels: Int64[np.ndarray, " M"],
) -> Float64[np.ndarray, "M 3"]:
    """Return the first principal axis of the normals in some voxels, pointing outward."""
    place = np.full(len(grid), -1)
    place[voxels] = np.arange(len(voxels))
    chosen = place[rows] >= 0
    outer = normals[chosen, :, None] * normals[chosen, None, :] * pieces.areas[chosen, None, None]  # [P, 3, 3]
    scatter = np.zeros((len(voxels), 3, 3))
    np.add.at(scatter, place[rows[chosen]], outer)
    axis = np.linalg.eigh(scatter)[1][:, :, 2]
    outward = grid.centres_m[voxels].astype(np.float64) - grid.centres_m.mean(axis=0, dtype=np.float64)
    towards: Float64[np.ndarray, "M 3"] = axis * np.where((axis * outward).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
    return towards
