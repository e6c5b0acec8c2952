"""voxelize: the occupied voxels are exactly those that the surface passes through."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.errors import InputError, MeshError
from dynamictree.mesh import TriangleMesh, join_meshes
from dynamictree.voxel import voxelize as voxelize_module
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import surface_average, voxelize


def soup(rng: np.random.Generator, num_faces: int, size: float) -> TriangleMesh:
    centres = rng.uniform(-1, 1, (num_faces, 1, 3))
    vertices = (centres + size * rng.normal(size=(num_faces, 3, 3))).reshape(-1, 3).astype(np.float32)
    return TriangleMesh(vertices=vertices, faces=np.arange(3 * num_faces, dtype=np.int32).reshape(-1, 3))


def square(z: float = 0.0, flip: bool = False) -> TriangleMesh:
    vertices = np.array([[0, 0, z], [1, 0, z], [1, 1, z], [0, 1, z]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return TriangleMesh(vertices=vertices, faces=np.ascontiguousarray(faces[:, ::-1]) if flip else faces)


def separated(corners: np.ndarray, lows: np.ndarray) -> np.ndarray:
    """Whether an axis separates a triangle from each unit box at `lows` (the oracle: Akenine-Möller 2001)."""
    edges = np.roll(corners, -1, axis=0) - corners
    axes = [*np.eye(3), np.cross(edges[0], edges[1]), *(np.cross(e, axis) for e in edges for axis in np.eye(3))]
    apart = np.zeros(len(lows), bool)
    for axis in axes:
        reach, middle = 0.5 * np.abs(axis).sum(), (lows + 0.5) @ axis
        apart |= ((corners @ axis).min() - middle > reach) | ((corners @ axis).max() - middle < -reach)
    return apart


@pytest.mark.parametrize("size", [0.05, 0.5, 1.0])
def test_occupied_voxels_are_those_that_the_separating_axis_test_finds(rng, size: float) -> None:
    mesh = soup(rng, 12, size)
    grid = voxelize(mesh, 32).grid
    expected = set()
    for corners in (mesh.vertices[mesh.faces].astype(np.float64) - grid.origin_m) / grid.voxel_size_m:
        low, high = np.floor(corners.min(axis=0)).astype(int), np.floor(corners.max(axis=0)).astype(int)
        box = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
        voxels = box.reshape(-1, 3)
        expected |= {tuple(voxel) for voxel in voxels[~separated(corners, voxels)].tolist()}
    assert {tuple(voxel) for voxel in grid.coords.tolist()} == expected


def test_finer_grids_nest_in_coarser_ones(rng) -> None:
    mesh = soup(rng, 60, 0.2)
    fine, coarse = voxelize(mesh, 128).grid, voxelize(mesh, 32).grid
    pooled = VoxelGrid.from_coords(
        fine.coords // 4, origin_m=coarse.origin_m, voxel_size_m=coarse.voxel_size_m, resolution=32
    )
    np.testing.assert_array_equal(pooled.coords, coarse.coords)
    assert fine.origin_m == coarse.origin_m
    assert fine.voxel_size_m * 4 == pytest.approx(coarse.voxel_size_m, rel=1e-15)


@pytest.mark.parametrize("resolution", [32, 64, 128, 256, 512])
def test_every_resolution_holds_every_vertex(rng, resolution: int) -> None:
    mesh = soup(rng, 30, 0.05)
    grid = voxelize(mesh, resolution).grid
    assert grid.resolution == resolution
    assert (grid.rows_of(grid.coords_of(mesh.vertices)) >= 0).all()


def test_a_surface_in_a_boundary_plane_fills_one_layer() -> None:
    mesh = join_meshes([square(0.0), square(1.0)])
    grid = voxelize(mesh, 32).grid
    assert len(np.unique(grid.coords[:, 2])) == 2


def test_surface_average_gives_linear_values_at_the_middle_of_the_surface_in_each_voxel() -> None:
    """Edges cut voxels into pieces of different area: their mean is at the middle only if each counts by its area."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.37, 0.21, 0]], np.float32)
    mesh = TriangleMesh(vertices=vertices, faces=np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32))
    grid = voxelize(mesh, 32).grid
    average = surface_average(mesh, grid)
    np.testing.assert_allclose(average.sum(axis=1), 1, atol=1e-6)
    middle = average @ mesh.vertices
    inner = ((grid.coords[:, :2] > grid.coords[:, :2].min()) & (grid.coords[:, :2] < grid.coords[:, :2].max())).all(1)
    assert inner.sum() > 800
    np.testing.assert_allclose(middle[inner][:, :2], grid.centres_m[inner][:, :2], atol=1e-6)


def test_normals_are_unit_and_follow_the_winding() -> None:
    for flip, sign in ((False, 1), (True, -1)):
        normals = voxelize(square(flip=flip), 32).normals
        np.testing.assert_allclose(normals, np.tile([0, 0, sign], (len(normals), 1)), atol=1e-6)


def test_the_sides_of_a_two_sided_card_do_not_cancel() -> None:
    card = join_meshes([square(), square(flip=True)])
    normals = voxelize(card, 32).normals
    np.testing.assert_allclose(np.abs(normals @ [0, 0, 1]), 1, atol=1e-6)


def test_normals_average_by_area() -> None:
    wall = TriangleMesh(
        vertices=np.array([[0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]], np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    voxels = voxelize(join_meshes([square(), wall]), 32)
    corner = np.linalg.norm(voxels.normals - np.array([0.5**0.5, 0, 0.5**0.5]), axis=1) < 0.3
    assert 25 <= corner.sum() <= 40  # the row of voxels where floor and wall meet


def test_resolution_out_of_range_is_refused() -> None:
    for resolution in (31, 513):
        with pytest.raises(InputError, match="32 to 512"):
            voxelize(square(), resolution)


@pytest.mark.parametrize(
    ("along", "faces", "message"), [(0, [], "no faces"), (0, [[0, 1, 2]], "one point"), (1, [[0, 1, 2]], "area")]
)
def test_a_mesh_without_a_surface_is_refused(along: int, faces: list[list[int]], message: str) -> None:
    line = along * np.arange(3, dtype=np.float32)[:, None] * np.ones(3, np.float32)
    with pytest.raises(MeshError, match=message):
        voxelize(TriangleMesh(vertices=line, faces=np.array(faces, np.int32).reshape(-1, 3)))


def test_more_surface_than_memory_allows_is_refused_before_it_is_cut(monkeypatch) -> None:
    monkeypatch.setattr(voxelize_module, "MAX_PIECES", 1000)
    with pytest.raises(MeshError, match="at most 1e\\+03"):
        voxelize(square(), 128)


def test_surface_average_refuses_a_voxel_without_surface() -> None:
    mesh = square()
    grid = voxelize(mesh, 32).grid
    stray = replace(grid, coords=np.concatenate([grid.coords, [[31, 31, 31]]]).astype(np.int32))
    with pytest.raises(InputError, match=r"voxel \[31, 31, 31\]"):
        surface_average(mesh, stray)
    with pytest.raises(MeshError, match=r"from \[0.0, 0.0, 9.0\] to \[1.0, 1.0, 9.0\] m, and the tree lies between"):
        surface_average(square(9.0), grid)
