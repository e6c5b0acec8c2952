"""preserve_lengths: a motion that stretches comes out bending; one that does not comes out as it was."""

import numpy as np
import pytest

from dynamictree.devoxelize import length_preserving as module
from dynamictree.devoxelize.length_preserving import length_preserving, preserve_lengths
from dynamictree.devoxelize.smooth import smooth
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.spectrum import from_motion, to_motion
from dynamictree.voxel.voxelize import voxelize
from tests.devoxelize.test_interpolation import bending_motion as bent
from tests.devoxelize.test_interpolation import size_of, stretch, tube, two_close_twigs

VOXEL_M = 0.08


@pytest.fixture(scope="module")
def twigs() -> tuple[TriangleMesh, np.ndarray]:
    """Two twigs on a trunk, and the spectrum of the first one's bending."""
    mesh, owner = two_close_twigs()
    return mesh, from_motion(bent(mesh, owner == 1), 11)


def noisy(coefficients: np.ndarray, size: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(*coefficients.shape, 2)).astype(np.float32) * size
    noise[:, 0, :, 1] = 0  # a mean is real
    return coefficients + noise.view(np.complex64)[..., 0]


def p99(mesh: TriangleMesh, coefficients: np.ndarray) -> float:
    return float(np.percentile(stretch(mesh, to_motion(coefficients, 60)), 99))


def test_a_bending_that_stretches_nothing_stays(twigs: tuple[TriangleMesh, np.ndarray]) -> None:
    mesh, coefficients = twigs
    preserved = preserve_lengths(mesh, coefficients, VOXEL_M)
    difference = to_motion(preserved - coefficients, 60)
    assert size_of(difference) < 0.03 * size_of(to_motion(coefficients, 60))


def test_a_shift_of_the_whole_stays(twigs: tuple[TriangleMesh, np.ndarray]) -> None:
    mesh, _ = twigs
    shift = np.tile(np.array([[0.1, 0, 0], [0.03 + 0.02j, 0.01j, 0]], np.complex64), (mesh.num_vertices, 1, 1))
    np.testing.assert_allclose(preserve_lengths(mesh, shift, VOXEL_M), shift, atol=1e-5)


def test_noise_between_neighbours_no_longer_stretches(twigs: tuple[TriangleMesh, np.ndarray]) -> None:
    mesh, coefficients = twigs
    rough = noisy(coefficients, 0.0003)
    assert p99(mesh, rough) > 0.5
    assert p99(mesh, preserve_lengths(mesh, rough, VOXEL_M)) < 0.01


def test_noise_beyond_help_does_not_grow(twigs: tuple[TriangleMesh, np.ndarray]) -> None:
    mesh, coefficients = twigs
    hopeless = noisy(coefficients, 0.003)  # twigs are turned inside out
    assert p99(mesh, preserve_lengths(mesh, hopeless, VOXEL_M)) < p99(mesh, hopeless)


def test_a_bend_by_linear_displacement_gets_its_length_back() -> None:
    pole = tube([0, 0, 0], [0, 0, 1], 0.03, rings=10)
    lean = np.zeros((pole.num_vertices, 2, 3), np.complex64)
    lean[:, 0, 0] = 0.2 * pole.vertices[:, 2] ** 2  # fixed at its root
    preserved = preserve_lengths(pole, lean, VOXEL_M)
    assert p99(pole, preserved) < 0.3 * p99(pole, lean)
    height = preserved[:, 0, 2].real
    assert height[-6:].mean() < height[:6].mean() - 0.01  # the tip comes down


def test_what_is_at_one_place_moves_as_one() -> None:
    pole = tube([0, 0, 0], [0, 0, 4], 0.2)
    split = TriangleMesh(
        vertices=pole.vertices[pole.faces].reshape(-1, 3),
        faces=np.arange(3 * pole.num_faces, dtype=np.int32).reshape(-1, 3),
    )
    grid = voxelize(split, 64).grid
    rough = noisy(np.zeros((len(grid), 4, 3), np.complex64), 0.01)
    for moved in (smooth(grid, split).apply(rough), length_preserving(grid, split).apply(rough)):
        for corner in np.unique(pole.faces)[:50]:
            np.testing.assert_array_equal(
                *np.broadcast_arrays(moved[(pole.faces == corner).ravel()], moved[pole.faces.ravel() == corner][:1])
            )


def test_the_same_input_gives_the_same_bits(twigs: tuple[TriangleMesh, np.ndarray]) -> None:
    mesh, coefficients = twigs
    first, second = (preserve_lengths(mesh, noisy(coefficients, 0.003), VOXEL_M) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_edges_in_many_lots_make_the_same_motion(
    twigs: tuple[TriangleMesh, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh, coefficients = twigs
    whole = preserve_lengths(mesh, coefficients, VOXEL_M)
    monkeypatch.setattr(module, "_EDGES_AT_ONCE", 100)
    assert len(edges_of(mesh.faces)) > 100
    np.testing.assert_allclose(preserve_lengths(mesh, coefficients, VOXEL_M), whole, atol=1e-5)


def test_an_edge_without_length_is_left_out() -> None:
    card = TriangleMesh(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 0]], np.float32),
        faces=np.array([[0, 1, 2], [1, 2, 3]], np.int32),
    )
    assert np.isfinite(preserve_lengths(card, noisy(np.zeros((4, 3, 3), np.complex64), 0.01), VOXEL_M)).all()


def test_small_motions_are_preserved_relative_to_their_size() -> None:
    pole = tube([0, 0, 0], [0, 0, 4], 0.05)
    height = pole.vertices[:, 2]
    sway = np.zeros((pole.num_vertices, 3, 3), np.complex64)
    sway[:, 1, 0] = 0.1 * (height / 4) ** 2
    sway[:, 1, 2] = 0.03 * (height / 4) ** 2  # along itself, which it cannot
    preserved = preserve_lengths(pole, sway, VOXEL_M)
    foot = (height > 0.4) & (height < 1)
    ratio = np.abs(preserved[foot, 1, 0]) / np.abs(sway[foot, 1, 0])
    np.testing.assert_allclose(ratio, 1, atol=0.1)


def test_long_edges_are_preserved_too() -> None:
    coarse = tube([0, 0, 0], [0, 0, 4], 0.05, rings=6)  # edges of ten voxels
    sway = np.zeros((coarse.num_vertices, 3, 3), np.complex64)
    sway[:, 1, 2] = 0.03 * coarse.vertices[:, 2]
    assert p99(coarse, preserve_lengths(coarse, sway, VOXEL_M)) < 0.2 * p99(coarse, sway)
