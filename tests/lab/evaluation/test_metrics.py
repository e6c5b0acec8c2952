"""Every figure is what its name says on motions whose figure is known."""

import numpy as np
import pytest

from lab.evaluation import metrics

EDGES = np.array([[0, 1], [1, 2], [2, 3]], np.int32)


def motion(sizes: list[float], *, k: int = 2, phase: float = 0.0) -> np.ndarray:
    coefficients = np.zeros((len(sizes), 16, 3), np.complex64)
    coefficients[:, k, 0] = np.array(sizes) * np.exp(1j * phase)
    return coefficients


def random_motion(rng: np.random.Generator, count: int = 40) -> np.ndarray:
    return (rng.standard_normal((count, 16, 3)) + 1j * rng.standard_normal((count, 16, 3))).astype(np.complex64)


def test_amplitude_is_root_of_twice_the_variance_of_the_motion(rng) -> None:
    from dynamictree.spectrum import to_motion

    coefficients = random_motion(rng)
    series = to_motion(coefficients, 100)
    spread = np.sqrt(((series - series.mean(axis=0)) ** 2).sum(axis=2).mean(axis=0))
    np.testing.assert_allclose(metrics.amplitude(coefficients), spread, rtol=1e-5)


def test_a_tree_wide_factor_costs_nothing_in_log_amplitude(rng) -> None:
    truth = random_motion(rng)
    correlation, rmse = metrics.log_amplitude_agreement(3 * truth, truth, 10.0)
    assert correlation == pytest.approx(1)
    assert rmse == pytest.approx(0, abs=1e-6)
    half = truth.copy()
    half[:20] *= 2
    assert metrics.log_amplitude_agreement(half, truth, 10.0)[1] == pytest.approx(np.log(2) / 2, rel=1e-3)


def test_centroid_is_the_bin_of_a_pure_tone(rng) -> None:
    np.testing.assert_allclose(metrics.centroid(motion([1.0, 2.0], k=5)), 5)
    truth = random_motion(rng)
    assert metrics.centroid_correlation(truth * 2, truth) == pytest.approx(1)


def test_roughness_is_zero_where_all_move_alike_and_known_on_a_step() -> None:
    assert metrics.roughness(motion([1, 1, 1, 1]), EDGES) == 0
    assert metrics.roughness(motion([1, 1, 2, 2]), EDGES) == pytest.approx((1 / 3) / 1.5)


def test_phase_agreement_falls_from_one_to_minus_one() -> None:
    alike, against = motion([1, 1, 1, 1]), motion([1, -1, 1, -1])
    assert metrics.phase_agreement(alike, EDGES) == pytest.approx(1)
    assert metrics.phase_agreement(against, EDGES) == pytest.approx(-1)


def test_energy_shares_sum_to_one_and_sit_in_their_bin() -> None:
    shares = metrics.energy_by_frequency(motion([1, 2, 3, 4], k=7))
    assert shares.sum() == pytest.approx(1)
    assert shares[6] == pytest.approx(1)


def test_a_rigid_shift_stretches_nothing_and_a_pull_its_own_share() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], np.float32)
    assert metrics.edge_stretch(motion([0.5] * 4), vertices, EDGES) == pytest.approx((0, 0), abs=1e-6)
    pulled = np.zeros((4, 16, 3), np.complex64)
    pulled[:, 0, 0] = 0.1 * vertices[:, 0]
    assert metrics.edge_stretch(pulled, vertices, EDGES) == pytest.approx((0.1, 0.1), rel=1e-4)


def test_roots_and_lean_are_shares_of_the_height() -> None:
    vertices = np.array([[0, 0, 0], [0, 0, 5], [0, 0, 8], [0, 0, 10]], np.float32)
    coefficients = np.zeros((4, 16, 3), np.complex64)
    coefficients[0, 0, 2] = 0.05
    coefficients[2:, 0, 1] = 1.0
    assert metrics.root_share(coefficients, vertices) == pytest.approx(0.005)
    assert metrics.downwind_lean(coefficients, vertices, 90.0) == pytest.approx(0.1)
    assert metrics.downwind_lean(coefficients, vertices, -90.0) == pytest.approx(-0.1)


def test_a_band_limited_motion_has_no_loop_jump(rng) -> None:
    assert metrics.loop_jump(random_motion(rng)) <= 1.2
    assert metrics.loop_jump(motion([1.0], k=1, phase=np.pi / 2)) == pytest.approx(1, abs=0.01)
