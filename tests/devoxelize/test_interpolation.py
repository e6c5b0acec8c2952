"""devoxelize: values at voxels become values at vertices, and what only passes close by has no part in them."""

from dataclasses import replace

import numpy as np

from dynamictree import method
from dynamictree.devoxelize.nearest import nearest_rows
from dynamictree.mesh import TriangleMesh, edges_of, join_meshes
from dynamictree.spectrum import SparseVoxelSpectrum, from_motion
from dynamictree.voxel.voxelize import surface_average, voxelize

HOW: tuple[method.Devoxelization, ...] = ("paper", "rig")


def tube(start: list[float], end: list[float], radius: float, *, rings: int = 40, sides: int = 6) -> TriangleMesh:
    """An open cylinder; vertices ring by ring from start to end."""
    low, high = np.array(start), np.array(end)
    along = (high - low) / np.linalg.norm(high - low)
    across = np.cross(along, [0.36, 0.48, 0.8])
    across /= np.linalg.norm(across)
    angle = 2 * np.pi * np.arange(sides) / sides
    circle = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(along, across))
    middle = low + np.linspace(0, 1, rings)[:, None] * (high - low)
    vertices = (middle[:, None] + radius * circle).reshape(-1, 3).astype(np.float32)
    ring, side = (a.ravel() for a in np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij"))
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    faces = np.concatenate([np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)]).astype(np.int32)
    return TriangleMesh(vertices=vertices, faces=faces)


def merged(*meshes: TriangleMesh) -> tuple[TriangleMesh, np.ndarray]:
    """One mesh, and which of them each vertex is from."""
    return join_meshes(meshes), np.repeat(np.arange(len(meshes)), [m.num_vertices for m in meshes])


def two_close_twigs() -> tuple[TriangleMesh, np.ndarray]:
    """A trunk, and two twigs 4 cm apart on it; voxels are 8 cm, so that most hold a piece of both twigs."""
    trunk = tube([0, 0, 0], [0, 0, 10], 0.2)
    return merged(trunk, tube([0.15, 0.00, 5], [3, 0.00, 6], 0.01), tube([0.15, 0.04, 5], [3, 0.04, 6], 0.01))


def bending_motion(mesh: TriangleMesh, moving: np.ndarray) -> np.ndarray:
    """Twigs bend sideways like rods, their tips by 0.2 m; the rest stands still."""
    along = np.array([2.85, 0, 1]) / np.linalg.norm([2.85, 0, 1])
    offset = mesh.vertices - np.array([0.15, 0, 5])
    reach = np.maximum(offset @ along, 0)  # [N]
    offset = offset - reach[:, None] * along
    swing = np.sin(2 * np.pi * np.arange(20) / 20)[:, None] * moving  # [T, N]
    turn = np.arctan(2 * 0.2 / 3**2 * reach * swing)
    sideways = 0.2 * (reach / 3) ** 2 * swing
    x, y = offset[:, 0], offset[:, 1]
    moved_x, moved_y = np.cos(turn) * x - np.sin(turn) * y - x, np.sin(turn) * x + np.cos(turn) * y - y
    return np.stack([moved_x, moved_y + sideways, np.zeros_like(turn)], axis=-1).astype(np.float32)


def through_voxels(mesh: TriangleMesh, displacement: np.ndarray, how: method.Devoxelization) -> np.ndarray:
    """The motion after a stay in the voxels' spectrum."""
    grid = voxelize(mesh, 128).grid
    coefficients = from_motion(displacement, 11)  # [N, K, 3]
    parts = coefficients.reshape(len(coefficients), -1).view(np.float32)
    in_voxels = (surface_average(mesh, grid) @ parts).view(np.complex64).reshape(len(grid), 11, 3)
    spectrum = SparseVoxelSpectrum(grid=grid, coefficients=in_voxels, num_frames=len(displacement))
    return np.stack(list(method.move(spectrum, mesh, devoxelization=how)))


def size_of(displacement: np.ndarray) -> float:
    return float(np.sqrt((displacement**2).sum(axis=-1).mean()))


def stretch(mesh: TriangleMesh, displacement: np.ndarray) -> np.ndarray:
    start, end = edges_of(mesh.faces).T
    moved = mesh.vertices + displacement
    length = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
    return np.abs(np.linalg.norm(moved[:, start] - moved[:, end], axis=2) / length - 1)


def test_a_twig_does_not_drag_another_that_passes_close_by() -> None:
    mesh, owner = two_close_twigs()
    motion = bending_motion(mesh, owner == 1)
    dragged = {how: size_of(through_voxels(mesh, motion, how)[:, owner == 2]) for how in HOW}
    whole = size_of(motion[:, owner == 1])
    assert dragged["paper"] > 0.3 * whole  # the voxels alone cannot tell the two apart
    assert dragged["rig"] < 0.12 * whole


def test_a_bent_twig_is_not_torn() -> None:
    mesh, owner = two_close_twigs()
    motion = bending_motion(mesh, owner > 0)
    assert np.percentile(stretch(mesh, motion), 99) < 0.02
    result = {how: np.percentile(stretch(mesh, through_voxels(mesh, motion, how)), 99) for how in HOW}
    assert result["rig"] < 0.03
    assert result["paper"] > 0.1


def test_a_leaf_card_follows_the_twig_that_it_hangs_on() -> None:
    """Its voxels hold another twig too, which stands still."""
    mesh, owner = two_close_twigs()
    card = TriangleMesh(
        vertices=np.array([[2.9, 0, 5.98], [2.95, -0.06, 5.98], [3.0, 0, 5.98], [2.95, 0.06, 5.98]], np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    leafy, part = merged(replace(mesh), card)
    owner = np.concatenate([owner, np.full(4, 1)])
    motion = bending_motion(leafy, owner == 1)
    result = through_voxels(leafy, motion, "rig")
    assert size_of(result[:, part == 1] - motion[:, part == 1]) < 0.2 * size_of(motion[:, part == 1])


def test_nearest_is_the_voxel_that_a_point_lies_in() -> None:
    mesh, _ = two_close_twigs()
    grid = voxelize(mesh, 128).grid
    rows = nearest_rows(grid, mesh.vertices)
    np.testing.assert_array_equal(rows, grid.rows_of(grid.coords_of(mesh.vertices)))
