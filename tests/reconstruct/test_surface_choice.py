"""The mesh that photos agree with is chosen, not the one of most faces."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.gaussian.cloud import GaussianCloud, join_clouds
from dynamictree.gaussian.from_mesh import splats_of_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.mesh import join_meshes as joined_meshes
from dynamictree.reconstruct.coloured_mesh import photo_colors
from dynamictree.reconstruct.splat_start import dome_points
from dynamictree.reconstruct.splat_table import cloud_of, table_of_points
from dynamictree.reconstruct.surface_choice import best_mesh
from tests.reconstruct.conftest import Orbit, stump_and_ground
from tests.reconstruct.test_coloured_mesh import views_of


@pytest.fixture(scope="module")
def scene(orbit: Orbit) -> GaussianCloud:
    """Gaussians of the stump, its ground and the sky."""
    both = joined_meshes(stump_and_ground(np.random.default_rng(5)))
    near = splats_of_mesh(both, per_face=1, at_least=30_000, rng=np.random.default_rng(0)).cloud
    points, colors, share = dome_points(views_of(orbit))
    points, colors = points[share > 0], colors[share > 0]
    size = np.full(len(points), 0.4, np.float32)
    sky = cloud_of(table_of_points(points, colors, size, opacity=0.95, sh_degree=0))
    return join_clouds([replace(near, sh=near.sh[:, :1]), sky])


def lower_half(stump: TriangleMesh) -> TriangleMesh:
    return replace(stump, faces=stump.faces[(stump.vertices[stump.faces, 2] < 0.6).all(axis=1)])


def fat(stump: TriangleMesh) -> TriangleMesh:
    return stump.with_vertices((stump.vertices * np.float32([1.35, 1.35, 1])).astype(np.float32))


def with_walls(stump: TriangleMesh) -> TriangleMesh:
    """The stump with a sheet of air beside it."""
    corners = np.float32([[0.3, 0.6, 0], [0.3, 1.4, 0], [0.3, 1.4, 1.2], [0.3, 0.6, 1.2]])
    faces = np.int32([[0, 1, 2], [0, 2, 3]]) + stump.num_vertices
    return TriangleMesh(vertices=np.concatenate([stump.vertices, corners]), faces=np.concatenate([stump.faces, faces]))


def coloured(mesh: TriangleMesh, orbit: Orbit) -> TriangleMesh:
    return replace(mesh, look=replace(mesh.look, vertex_colors=photo_colors(mesh, views_of(orbit))))


@pytest.fixture(scope="module")
def stump(orbit: Orbit) -> TriangleMesh:
    return coloured(TriangleMesh(vertices=orbit.stump.vertices, faces=orbit.stump.faces), orbit)


@pytest.mark.parametrize("worse", [lower_half, fat, with_walls])
def test_photos_choose_the_true_mesh(orbit: Orbit, scene: GaussianCloud, stump: TriangleMesh, worse) -> None:
    meshes = {"true": stump, "worse": coloured(worse(stump), orbit)}
    for first in (True, False):
        ordered = dict(sorted(meshes.items(), reverse=first))
        assert best_mesh(ordered, scene, views_of(orbit)[2::5], radius=1.0) == "true"


def test_the_first_mesh_is_taken_unless_another_is_clearly_better(
    orbit: Orbit, scene: GaussianCloud, stump: TriangleMesh
) -> None:
    views = views_of(orbit)
    wider = stump.with_vertices((stump.vertices * np.float32([1.001, 1.001, 1])).astype(np.float32))
    for first, second in ((stump, wider), (wider, stump)):
        assert best_mesh({"first": first, "second": second}, scene, views[2::5], radius=1.0) == "first"
    assert best_mesh({"only": wider}, scene, [], radius=1.0) == "only"
