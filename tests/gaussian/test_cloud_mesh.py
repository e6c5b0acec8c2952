"""Meshes of clouds, and clouds of meshes."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from benchmarks._gaussian_scene import wavy_sheet
from dynamictree.errors import InputError
from dynamictree.gaussian.binding import bind
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud, opacity_grid
from dynamictree.gaussian.deform import Deformer
from dynamictree.gaussian.from_mesh import GAUSSIANS_PER_FACE, face_shapes, splats_of_mesh
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import Material, MeshLook, TriangleMesh
from dynamictree.rotation import quaternion_matrices
from tests.clouds import cloud_at
from tests.formats.meshes import png_of


def sphere_cloud(rng: np.random.Generator, *, opacity: float = 0.9) -> GaussianCloud:
    """Points on a sphere of radius 1 around (3, 0, 0)."""
    count = 4000
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return cloud_at(np.add(directions, [3, 0, 0]), scale=0.03, opacity=opacity, sh=np.full((count, 1, 3), 0.3 / SH_0))


def plane(side: int = 6) -> TriangleMesh:
    """A level square of 1 m, whose texture coordinates are its x and y."""
    x, y = np.meshgrid(*[np.linspace(0, 1, side)] * 2, indexing="ij")
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32)
    faces = wavy_sheet(2 * (side - 1) ** 2).faces
    return TriangleMesh(vertices=vertices, faces=faces, look=MeshLook(uv=vertices[:, :2].copy()))


def textured(material: Material) -> TriangleMesh:
    mesh = plane()
    look = replace(mesh.look, face_material=np.zeros(mesh.num_faces, np.int32), materials=(material,))
    return replace(mesh, look=look)


def test_the_surface_lies_around_the_gaussians(rng) -> None:
    cloud = sphere_cloud(rng)
    mesh = mesh_of_cloud(cloud, cells_along=64, max_faces=100_000)
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert shape.is_watertight
    radii = np.linalg.norm(mesh.vertices - [3, 0, 0], axis=1)
    assert 0.95 < radii.min() < radii.max() < 1.15  # no second surface inside
    assert 0.9 < shape.volume / (4 / 3 * np.pi) < 1.4  # solid, though the capture is hollow, and faces look outward
    np.testing.assert_array_equal(mesh.look.vertex_colors, np.tile([204, 204, 204, 255], (mesh.num_vertices, 1)))
    assert bind(cloud, mesh).moving.all()


def test_a_large_surface_is_simplified(rng) -> None:
    assert mesh_of_cloud(sphere_cloud(rng), cells_along=64, max_faces=2000).num_faces <= 2000


def test_the_grid_holds_the_opacity_of_each_gaussian() -> None:
    one = cloud_at(np.full((1, 3), 0.5), turned=[np.cos(0.3), 0, 0, np.sin(0.3)], scale=[0.3, 0.1, 0.001], opacity=0.8)
    grid = opacity_grid(one, np.zeros(3, np.float32), 0.1, (10, 10, 10))
    places = (np.stack(np.meshgrid(*[np.arange(10)] * 3, indexing="ij"), axis=-1) + 0.5) * 0.1 - 0.5
    own = places @ quaternion_matrices(one.quaternions.astype(np.float64))[0] / [0.3, 0.1, 0.05]  # half a cell at least
    distance = (own**2).sum(axis=-1)
    expected = np.where(distance < 2.5**2, 0.8 * np.exp(-0.5 * distance), 0)
    np.testing.assert_allclose(grid, expected, atol=1e-4)


def test_what_has_no_surface_is_reported(rng) -> None:
    with pytest.raises(InputError, match="nowhere denser"):
        mesh_of_cloud(sphere_cloud(rng, opacity=0.01).subset(np.arange(10)), cells_along=32)
    cloud = sphere_cloud(rng)
    with pytest.raises(InputError, match="at one place"):
        mesh_of_cloud(replace(cloud, means=np.zeros_like(cloud.means), scales=np.zeros_like(cloud.scales)))


def test_gaussians_in_one_another_have_the_surface_of_the_largest(rng) -> None:
    cloud = sphere_cloud(rng).subset(np.arange(5))
    scales = np.full((5, 3), 0.1, np.float32)
    scales[0] = 0.5
    mesh = mesh_of_cloud(replace(cloud, means=np.zeros_like(cloud.means), scales=scales), cells_along=32)
    radius = 0.5 * np.sqrt(2 * np.log(0.9 / 0.3))  # where 0.9 exp(-½ (r / 0.5)²) is the level
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), radius, rtol=0.05)


def test_far_strays_do_not_coarsen_the_surface(rng) -> None:
    cloud = sphere_cloud(rng)
    means = cloud.means.copy()
    means[:3] += 1000
    mesh = mesh_of_cloud(replace(cloud, means=means), cells_along=64)
    assert np.ptp(mesh.vertices, axis=0).max() < 3


def test_gaussians_of_a_mesh_cover_it_evenly(rng) -> None:
    mesh = plane()
    splat = splats_of_mesh(mesh, at_least=0, rng=rng)
    assert splat.cloud.num_gaussians == GAUSSIANS_PER_FACE * mesh.num_faces
    np.testing.assert_array_equal(np.bincount(splat.binding.face_of), GAUSSIANS_PER_FACE)
    np.testing.assert_allclose(splat.cloud.means[:, 2], 0, atol=1e-6)
    normals = quaternion_matrices(splat.cloud.quaternions)[:, :, 0]
    np.testing.assert_allclose(np.abs(normals[:, 2]), 1, atol=1e-5)  # the flat axis stands on the face
    assert (splat.cloud.scales[:, 0] < 0.05 * splat.cloud.scales[:, 1:].min(axis=1)).all()
    pose = Deformer(splat.binding).pose(np.zeros_like(mesh.vertices))
    np.testing.assert_allclose(pose.means, splat.cloud.means, atol=1e-6)
    many = splats_of_mesh(mesh, at_least=5000, rng=rng).cloud
    assert 4900 < many.num_gaussians <= 5000
    counts = np.histogram2d(*many.means[:, :2].T, bins=5)[0]
    assert counts.std() < 0.2 * counts.mean()


def test_face_shapes_are_those_of_games(rng) -> None:
    corners = rng.normal(size=(20, 3, 3))
    rotations, scales = face_shapes(corners)
    middle = corners.mean(axis=1)
    second = corners[:, 1] - middle
    np.testing.assert_allclose(rotations[:, :, 1], second / np.linalg.norm(second, axis=1, keepdims=True), atol=1e-12)
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)
    ratio = scales[:, 1] / scales[:, 2]
    width = np.abs(np.einsum("fx,fx->f", corners[:, 2] - middle, rotations[:, :, 2]))
    np.testing.assert_allclose(ratio, np.linalg.norm(second, axis=1) / width, rtol=1e-6)


def test_colours_come_from_the_texture(rng) -> None:
    left_red = np.zeros((8, 8, 3), np.uint8)
    left_red[:, :4, 0], left_red[:, 4:, 2] = 255, 255
    mesh = textured(Material(base_color=(1.0, 1.0, 1.0, 1.0), texture_png=png_of(left_red)))
    cloud = splats_of_mesh(mesh, at_least=2000, rng=rng).cloud
    color = cloud.sh[:, 0] * SH_0 + 0.5
    x = cloud.means[:, 0]
    inner = (np.abs(x - 0.5) > 0.15) & (np.abs(x - 0.5) < 0.35)  # the texture repeats beyond its edge
    np.testing.assert_allclose(color[inner, 0], x[inner] < 0.5, atol=0.05)
    np.testing.assert_allclose(color[inner, 2], x[inner] > 0.5, atol=0.05)


def test_colours_come_from_the_vertices(rng) -> None:
    mesh, color = plane(), np.uint8([30, 200, 90, 255])
    look = replace(mesh.look, vertex_colors=np.tile(color, (mesh.num_vertices, 1)))
    cloud = splats_of_mesh(replace(mesh, look=look), at_least=0, rng=rng).cloud
    np.testing.assert_allclose(cloud.sh[:, 0] * SH_0 + 0.5, np.tile(color[:3] / 255, (250, 1)), atol=0.01)


def test_holes_of_a_texture_have_no_gaussians(rng) -> None:
    half = np.full((8, 8, 4), 255, np.uint8)
    half[:, :4, 3] = 0
    mesh = textured(Material(texture_png=png_of(half), alpha_cutoff=0.5))
    cloud = splats_of_mesh(mesh, at_least=2000, rng=rng).cloud
    assert cloud.means[:, 0].min() > 0.45
    clear = textured(Material(texture_png=png_of(0 * half), alpha_cutoff=0.5))
    with pytest.raises(InputError, match="transparent on every face"):
        splats_of_mesh(clear, at_least=0, rng=rng)
    with pytest.raises(InputError, match="per_face is 0"):
        splats_of_mesh(plane(), per_face=0, rng=rng)
