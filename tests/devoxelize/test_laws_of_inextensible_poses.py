"""A large motion bends a tree and turns its leaves; it stretches neither."""

import numpy as np
import pytest
from jaxtyping import Complex64, Float32

from dynamictree.devoxelize.inextensible import (
    InextensiblePose,
    inextensible_pose,
    nearest_rotations,
    typical_stretch,
    without_stretch,
)
from dynamictree.devoxelize.length_preserving import LengthPreservingInterpolation, length_preserving
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.turbulence import iter_turbulent_motion, turbulent_wind
from dynamictree.spectrum import SparseVoxelSpectrum, Wind, to_motion
from dynamictree.voxel.voxelize import voxelize
from lab.dataset.motion import vertex_spectrum
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from lab.dataset.wind import sway

Motion = Float32[np.ndarray, "T N 3"]


class Sample:
    """A generated tree in leaf, and its true motion in a breeze."""

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        tree = grow_tree(SPECIES["palm"], rng)
        self.mesh: TriangleMesh = tree.mesh
        motion = sway(tree, Wind(speed_m_s=6.0), rng)
        self.coefficients: Complex64[np.ndarray, "N K 3"] = vertex_spectrum(motion, tree.mesh.vertices, tree.node)
        self.interpolation: LengthPreservingInterpolation = length_preserving(voxelize(tree.mesh, 128).grid, tree.mesh)
        self.pose: InextensiblePose = inextensible_pose(self.interpolation, self.coefficients)

    def frames(self, times: float) -> Motion:
        return np.stack([self.pose.apply(frame) for frame in to_motion(np.complex64(times) * self.coefficients)[::10]])


@pytest.fixture(scope="module")
def sample() -> Sample:
    return Sample()


def stretch(mesh: TriangleMesh, motion: Motion) -> Float32[np.ndarray, "T E"]:
    start, end = edges_of(mesh.faces).T
    across = mesh.vertices[start] - mesh.vertices[end]
    length = np.linalg.norm(across, axis=1)
    moved = np.linalg.norm(across + motion[:, start] - motion[:, end], axis=2)
    return np.abs(moved / np.maximum(length, 1e-9) - 1)[:, length > 0]


def area_change(mesh: TriangleMesh, motion: Motion) -> Float32[np.ndarray, "T F"]:
    def areas(points: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, " F"]:
        a, b, c = points[mesh.faces.T]
        return np.linalg.norm(np.cross(b - a, c - a), axis=1)

    rest = areas(mesh.vertices)
    return np.abs(np.stack([areas(mesh.vertices + frame) for frame in motion]) / rest - 1)


@pytest.mark.parametrize("times", [3.0, 10.0])
def test_edges_keep_their_length_however_large_the_motion(sample: Sample, times: float) -> None:
    linear = np.float32(times) * to_motion(sample.coefficients)[::10]
    assert np.percentile(stretch(sample.mesh, linear), 99) > 0.05
    assert np.percentile(stretch(sample.mesh, sample.frames(times)), 99) < 0.02


def test_endless_wind_stretches_no_more_than_the_loop(sample: Sample) -> None:
    grid = sample.interpolation.grid
    still = np.zeros((len(grid), 16, 3), np.complex64)
    wind = turbulent_wind(SparseVoxelSpectrum(grid=grid, coefficients=still, wind=Wind(speed_m_s=6.0)), seed=1)
    strong = np.complex64(3) * sample.coefficients
    times = np.arange(0, 60, 3.1)
    endless = np.stack([sample.pose.apply(frame) for frame in iter_turbulent_motion(strong, wind, times, 100)])
    loop, endless_stretch = (
        np.percentile(stretch(sample.mesh, motion), 99) for motion in (sample.frames(3.0), endless)
    )
    assert endless_stretch < max(1.1 * loop, 0.005)


def test_leaf_cards_are_rigid_in_any_wind(sample: Sample) -> None:
    cards = np.isin(sample.pose.vertex, sample.pose.rigid)[sample.mesh.faces].all(axis=1)
    assert cards.mean() > 0.3
    assert area_change(sample.mesh, np.float32(30) * to_motion(sample.coefficients)[::10])[:, cards].max() > 1
    assert area_change(sample.mesh, sample.frames(30.0))[:, cards].max() < 1e-3


def test_a_branch_goes_less_far_the_more_it_is_bent(sample: Sample) -> None:
    reach = [np.linalg.norm(sample.frames(times), axis=2).max() / times for times in (1.0, 3.0, 10.0, 30.0)]
    assert reach == sorted(reach, reverse=True)
    assert reach[3] < 0.8 * reach[0]


def test_a_small_motion_stays_as_it_is(sample: Sample) -> None:
    small = 0.01 * to_motion(sample.coefficients)[::10]
    assert np.linalg.norm(sample.frames(0.01) - small) < 0.1 * np.linalg.norm(small)
    assert np.abs(sample.pose.apply(np.zeros_like(sample.mesh.vertices))).max() < 1e-6


def test_a_rigid_motion_stays_rigid(sample: Sample) -> None:
    turn = nearest_rotations(np.array([[[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]]]))[0].astype(np.float32)
    moved = sample.mesh.vertices @ turn.T - sample.mesh.vertices + np.float32(0.3)
    np.testing.assert_allclose(sample.pose.apply(moved), moved, atol=0.005 * sample.mesh.height_m)  # gaps do not turn


def test_a_loop_without_stretch_is_a_spectrum_again(sample: Sample) -> None:
    strong = np.complex64(2) * sample.coefficients
    loop = without_stretch(sample.pose, strong, 100)
    assert loop.shape == strong.shape
    assert typical_stretch(sample.interpolation, loop) < 0.5 * typical_stretch(sample.interpolation, strong)


def test_the_nearest_rotation_is_that_of_the_polar_decomposition(rng: np.random.Generator) -> None:
    turn = nearest_rotations(rng.normal(size=(50, 3, 3)))
    np.testing.assert_allclose(turn @ turn.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turn.shape), atol=1e-9)
    matrices = turn @ (np.eye(3) + 0.3 * np.einsum("nij,nkj->nik", *2 * [rng.normal(size=(50, 3, 3))]))
    u, _, vt = np.linalg.svd(matrices)
    near = np.abs(np.trace(u @ vt, axis1=1, axis2=2)) > -0.5
    np.testing.assert_allclose(nearest_rotations(matrices)[near], (u @ vt)[near], atol=1e-3)
    assert np.array_equal(nearest_rotations(np.zeros((1, 3, 3))), np.eye(3)[None])
