"""Create splats from a mesh: flat Gaussians in its faces, with its colours. GaMeS section 3.2."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32

from dynamictree.color import linear_to_srgb
from dynamictree.errors import InputError
from dynamictree.gaussian.binding import Binding, bind_to_faces, solid_faces
from dynamictree.gaussian.cloud import GaussianCloud, check_count
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import TriangleMesh
from dynamictree.parallel import compiled, in_bands
from dynamictree.render.appearance import albedo_at, alpha_at, appearance_of
from dynamictree.rotation import matrix_quaternions

GAUSSIANS_PER_FACE = 5  # number from GaMeS section 4
MIN_GAUSSIANS = 100_000
"""Least total number of Gaussians; a mesh of few faces has its detail in its texture."""
_WIDTH = 0.8  # factor of GaMeS' scales (its learned ρ); five such Gaussians cover a face without holes
_FLAT = 0.02  # thickness over width; GaMeS' 1e-8 m underflows in formats that quantise
_OPACITY = 0.97


@dataclass(frozen=True, kw_only=True)
class MeshSplat:
    """Cloud created from a mesh, and its binding to the mesh."""

    cloud: GaussianCloud
    binding: Binding


def splats_of_mesh(
    mesh: TriangleMesh, *, per_face: int = GAUSSIANS_PER_FACE, at_least: int = MIN_GAUSSIANS, rng: np.random.Generator
) -> MeshSplat:
    """Create `per_face` Gaussians on every face, more on large faces of small meshes, and none in holes of the texture.

    Raises:
        InputError: `per_face` is out of bounds, no face has an area, all is cut out, or there are too many Gaussians.
    """
    if not 1 <= per_face <= 100:
        raise InputError(f"per_face is {per_face}; 1 to 100 Gaussians a face are allowed")
    solid_faces(mesh)
    corners = mesh.vertices[mesh.faces].astype(np.float64)  # [F, 3, 3]
    counts = _counts(corners, per_face, at_least)
    check_count(int(counts.sum()))
    faces = np.repeat(np.arange(mesh.num_faces, dtype=np.int32), counts)
    weights = _even_weights(counts, rng)
    colors, opaque = face_colors(mesh, faces, weights, counts)
    if not opaque.any():
        raise InputError("the mesh's texture is transparent on every face; nothing is left to make Gaussians of")
    faces, weights, colors = faces[opaque], weights[opaque], colors[opaque]
    rotations, scales = face_shapes(corners)
    narrower = np.sqrt(GAUSSIANS_PER_FACE / counts[faces])[:, None]  # Gaussians are smaller if a face has more
    cloud = GaussianCloud(
        means=np.einsum("gc,gcx->gx", weights, mesh.vertices[mesh.faces[faces]]),
        quaternions=matrix_quaternions(rotations)[faces].astype(np.float32),
        scales=(scales[faces] * narrower).astype(np.float32),
        opacity=np.full(len(faces), _OPACITY, np.float32),
        sh=((colors - 0.5) / SH_0).astype(np.float32)[:, None],
        source=mesh.source,
    )
    return MeshSplat(cloud=cloud, binding=bind_to_faces(cloud, mesh, faces, weights))


def face_shapes(
    corners: Float64[np.ndarray, "F 3 3"],
) -> tuple[Float64[np.ndarray, "F 3 3"], Float64[np.ndarray, "F 3"]]:
    """Compute GaMeS' axes r₁ (normal), r₂ (centroid to corner 2), r₃ as columns, and scales along them."""
    tiny = 1e-12
    middle = corners.mean(axis=1)
    to_second, to_third = corners[:, 1] - middle, corners[:, 2] - middle
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    length = np.linalg.norm(to_second, axis=1, keepdims=True)
    flat = area[:, 0] <= tiny
    normal, along = normal / np.maximum(area, tiny), to_second / np.maximum(length, tiny)
    across = np.cross(normal, along)
    rotations = np.stack([normal, along, across], axis=2)
    rotations[flat] = np.eye(3)
    width = np.abs((to_third * across).sum(axis=1, keepdims=True))
    scales = _WIDTH * np.concatenate([_FLAT * np.minimum(length, width), length / 2, width / 2], axis=1)
    return rotations, np.maximum(scales, 1e-6)


def face_colors(
    mesh: TriangleMesh,
    faces: Int32[np.ndarray, " G"],
    weights: Float32[np.ndarray, "G 3"],
    counts: Int32[np.ndarray, " F"],
) -> tuple[Float32[np.ndarray, "G 3"], Bool[np.ndarray, " G"]]:
    """Sample display colours in [0, 1] at points on the faces, with a mask of points outside holes.

    A texture is sampled at the mip level whose texels are as large as the Gaussians.
    """
    appearance = appearance_of(mesh)
    corners = appearance.uv[mesh.faces].astype(np.float64)  # [F, 3, 2]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    uv_area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    levels = appearance.texture_levels[appearance.face_material]  # [F, L, 3]
    texels = uv_area * levels[:, 0, 1] * levels[:, 0, 2] / np.maximum(counts, 1)
    coarsest = np.maximum((levels[:, :, 1] > 0).sum(axis=1) - 1, 0)
    level = np.clip(np.floor(0.5 * np.log2(np.maximum(texels, 1))), 0, coarsest).astype(np.int32)
    rgba = np.empty((len(faces), 4), np.float32)
    in_bands(_sample_faces, len(faces), appearance, mesh.faces, faces, level, weights, rgba)
    opaque: Bool[np.ndarray, " G"] = rgba[:, 3] >= appearance.cutoff[appearance.face_material[faces]]
    return linear_to_srgb(rgba[:, :3]), opaque


@compiled
@no_type_check
def _sample_faces(first, end, appearance, mesh_faces, faces, level, weights, rgba):
    for g in range(first, end):
        f = faces[g]
        material = appearance.face_material[f]
        place = (weights[g, 0], weights[g, 1], weights[g, 2])
        color = albedo_at(appearance, mesh_faces[f], material, level[f], place)
        rgba[g, 0], rgba[g, 1], rgba[g, 2] = color[0], color[1], color[2]
        rgba[g, 3] = alpha_at(appearance, mesh_faces[f], material, level[f], place)


def _even_weights(counts: Int32[np.ndarray, " F"], rng: np.random.Generator) -> Float32[np.ndarray, "G 3"]:
    """Spread barycentric weights evenly over each face, by Roberts' R2 sequence with a random start."""
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)  # index of a Gaussian in its face
    golden = 1.32471795724474602596  # x³ = x + 1
    start = np.repeat(rng.random((len(counts), 2)), counts, axis=0)
    u, v = ((start + number[:, None] / np.array([golden, golden**2])) % 1).T
    beyond = u + v > 1
    u, v = np.where(beyond, 1 - u, u), np.where(beyond, 1 - v, v)
    return np.stack([1 - u - v, u, v], axis=1).astype(np.float32)


def _counts(corners: Float64[np.ndarray, "F 3 3"], per_face: int, at_least: int) -> Int32[np.ndarray, " F"]:
    """Return `per_face` for each face, plus a share by area of the number missing to `at_least` in total."""
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    missing = max(at_least - per_face * len(areas), 0)
    return np.asarray(per_face + np.floor(areas / areas.sum() * missing), np.int32)
