"""Moments of the surface in a voxel: exact where they can be reckoned by hand, and they tell a card from a tube."""

import tracemalloc

import numpy as np
import pytest

from dynamictree.mesh import TriangleMesh, join_meshes
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import AREA, NORMAL, OFFSET, SIX, SPREAD, coarse_moments, moments_of
from dynamictree.voxel.voxelize import surface_moments, surface_pieces, voxelize
from tests.devoxelize.test_interpolation import tube


def pole(radius_m: float, height_m: float, sides: int) -> TriangleMesh:
    """Upright on the origin; and a speck aside, so that the axis runs through the middles of voxels of 4 / 64."""
    aside = np.array([[0.0725, 0.0725, 0], [0.0725, 0.07, 0], [0.07, 0.0725, 0]], np.float32)
    speck = TriangleMesh(vertices=aside, faces=np.array([[0, 1, 2]], np.int32))
    return join_meshes([tube([0, 0, 0], [0, 0, height_m], radius_m, rings=2, sides=sides), speck])


def card(edge_m: float) -> TriangleMesh:
    """A square in the plane x = 0.3 y."""
    vertices = edge_m * np.array([[0, 0, 0], [0.3, 1, 0], [0.3, 1, 1], [0, 0, 1]])
    return TriangleMesh(vertices=vertices.astype(np.float32), faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def test_a_card_has_one_normal_and_a_tube_two() -> None:
    flat, round_ = voxelize(card(4.0), 64), voxelize(pole(0.01, 4.0, 5), 64)
    on_axis = np.abs(round_.grid.centres_m[:, :2]).max(axis=1) < 0.01
    assert on_axis.sum() > 60
    np.testing.assert_allclose(ranks(flat.moments[:, NORMAL]), np.tile([0, 0, 1], (len(flat.grid), 1)), atol=1e-6)
    np.testing.assert_allclose(
        ranks(round_.moments[on_axis, NORMAL])[2:-2], np.tile([0, 0.5, 0.5], (on_axis.sum() - 4, 1)), atol=1e-4
    )
    around = 5 * 2 * 0.01 * np.sin(np.pi / 5)  # circumference of the tube [m]
    edge = round_.grid.voxel_size_m
    np.testing.assert_allclose(round_.moments[on_axis, AREA][2:-2], around / edge, rtol=1e-3)
    np.testing.assert_allclose(flat.moments[:, AREA].sum() * flat.grid.voxel_size_m**2, 16 * 1.09**0.5, rtol=1e-4)


def ranks(six: np.ndarray) -> np.ndarray:
    """Eigenvalues, ascending."""
    full = np.zeros((len(six), 3, 3))
    for column, (i, j) in zip(six.T, SIX, strict=True):
        full[:, i, j] = full[:, j, i] = column
    return np.linalg.eigvalsh(full)


def test_the_centroid_is_the_surfaces() -> None:
    voxels = voxelize(pole(0.01, 4.0, 8), 64)
    place = (voxels.grid.coords + 0.5 + voxels.moments[:, OFFSET]) * voxels.grid.voxel_size_m + voxels.grid.origin_m
    on_axis = np.abs(voxels.grid.centres_m[:, :2]).max(axis=1) < 0.01
    np.testing.assert_allclose(place[on_axis, :2], 0, atol=1e-5)
    assert np.abs(voxels.moments[:, OFFSET]).max() <= 0.5 + 1e-6
    assert (voxels.moments[:, SPREAD][:, :3] > -1e-9).all()


def test_a_mesh_has_the_moments_that_its_voxels_were_made_with() -> None:
    mesh = card(2.0)
    voxels = voxelize(mesh, 32)
    np.testing.assert_allclose(surface_moments(mesh, voxels.grid), voxels.moments)


@pytest.mark.parametrize("mesh", [card(3.0), pole(0.02, 3.0, 6)])
def test_moments_of_larger_voxels_follow_from_the_finer_ones(mesh: TriangleMesh) -> None:
    fine = voxelize(mesh, 128)
    grid = fine.grid
    coarse = VoxelGrid.from_coords(
        grid.coords // 4, origin_m=grid.origin_m, voxel_size_m=4 * grid.voxel_size_m, resolution=32
    )
    owner = coarse.rows_of(grid.coords // 4)
    raised, direct = coarse_moments(fine.moments, grid, coarse, owner), surface_moments(mesh, coarse)
    for part in (AREA, OFFSET, NORMAL):
        np.testing.assert_allclose(raised[:, part], direct[:, part], atol=2e-3)
    # within a piece the spread is taken for a square's; finer pieces come closer to the truth, and none is larger
    assert raised[:, SPREAD][:, :3].min() > -1e-5
    assert raised[:, SPREAD][:, :3].sum(axis=1).max() < 0.5


def test_moments_of_many_pieces_take_little_memory() -> None:
    vertices = np.random.default_rng(0).normal(size=(6000, 3)).astype(np.float32)
    mesh = TriangleMesh(vertices=vertices, faces=np.arange(6000, dtype=np.int32).reshape(-1, 3))
    grid = voxelize(mesh, 64).grid
    pieces = surface_pieces(mesh, grid.origin_m, grid.voxel_size_m, grid.resolution)
    rows = np.searchsorted(grid.keys, pieces.keys)
    tracemalloc.start()
    moments_of(mesh, grid, pieces, rows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(rows) > 300_000
    assert peak < 200 * len(rows)  # 340 with all columns at once
