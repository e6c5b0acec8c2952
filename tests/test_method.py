"""The method on one page, called as a reader of it would."""

import numpy as np
import pytest
import trimesh

from dynamictree import method
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import ExportParams, Format, Wind
from dynamictree.spectrum import SparseVoxelSpectrum, to_motion
from tests.clouds import cloud_at

NUM_FRAMES = 6


@pytest.fixture(scope="module")
def post() -> trimesh.Trimesh:
    """A post of 2 m."""
    return trimesh.creation.cylinder(radius=0.1, height=2.0, sections=12).subdivide().subdivide()


@pytest.fixture(scope="module")
def spectrum(post: trimesh.Trimesh) -> SparseVoxelSpectrum:
    """Sways along +X, as the square of the height."""
    grid = method.voxelize(post, resolution=32).grid
    coefficients = np.zeros((len(grid), 2, 3), np.complex64)
    coefficients[:, 1, 0] = 0.01 * (grid.centres_m[:, 2] + 1) ** 2
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients, num_frames=NUM_FRAMES)


def test_vertices_follow_the_spectrum(post: trimesh.Trimesh, spectrum: SparseVoxelSpectrum) -> None:
    motion = to_motion(method.devoxelize(spectrum, post), NUM_FRAMES)
    top = post.vertices[:, 2] > 0.9
    expected = 2 * 0.01 * 4 * np.cos(2 * np.pi * np.arange(NUM_FRAMES) / NUM_FRAMES)
    np.testing.assert_allclose(motion[:, top, 0].mean(axis=1), expected, atol=0.01)
    assert np.abs(motion[:, post.vertices[:, 2] < -0.9]).max() < 0.01


def test_a_splat_follows_its_mesh(post: trimesh.Trimesh, spectrum: SparseVoxelSpectrum) -> None:
    cloud = cloud_at(post.triangles_center)
    motion = list(method.move(spectrum, post, num_frames=NUM_FRAMES))
    for frame, displacement in zip(
        method.animate_splat(cloud, post, spectrum, num_frames=NUM_FRAMES), motion, strict=True
    ):
        expected = (post.vertices + displacement)[post.faces].mean(axis=1)
        np.testing.assert_allclose(frame.means, expected, atol=1e-4)


def test_a_shape_becomes_a_loop(post: trimesh.Trimesh) -> None:
    frames = list(method.animate(post, num_frames=4, seed=1))
    assert len(frames) == 4
    assert all(frame.shape == post.vertices.shape and np.isfinite(frame).all() for frame in frames)
    assert np.abs(frames[0] - frames[2]).max() > 1e-6


def test_the_readme_s_lines_take_a_mesh_of_trimesh_to_its_files(post: trimesh.Trimesh, tmp_path) -> None:
    voxels = method.voxelize(post)
    spectrum = method.generate(voxels, seed=0, wind=Wind(speed_m_s=6.0), num_steps=1)
    formats: tuple[Format, ...] = ("png", "motion", "ply", "glb", "vat")
    of_trimesh, ours = tmp_path / "trimesh", tmp_path / "ours"
    for folder, mesh in ((of_trimesh, post), (ours, TriangleMesh.from_trimesh(post))):
        folder.mkdir()
        write_products(mesh, spectrum, ExportParams(formats=formats, fps=6.0), folder)
    assert len(list(ours.iterdir())) == len(formats)
    for path in ours.iterdir():
        assert (of_trimesh / path.name).read_bytes() == path.read_bytes()
