"""Laws of the sparse voxel spectrum."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamictree.errors import InputError
from dynamictree.spectrum import SparseVoxelSpectrum, bin_weights, from_motion, iter_motion, to_motion
from dynamictree.voxel.grid import VoxelGrid


def spectrum_of(rng: np.random.Generator, num_points: int = 7, num_frequencies: int = 16) -> np.ndarray:
    shape = (num_points, num_frequencies, 3)
    coefficients = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
    coefficients[:, 0].imag = 0
    return coefficients


def small_grid(num_voxels: int = 7) -> VoxelGrid:
    coords = np.arange(num_voxels, dtype=np.int32)[:, None] * np.ones(3, np.int32)
    return VoxelGrid(coords=coords, origin_m=(0.0, 0.0, 0.0), voxel_size_m=0.1, resolution=32)


@settings(max_examples=30)
@given(num_frames=st.integers(1, 64), seed=st.integers(0, 2**32))
def test_a_full_spectrum_round_trips(num_frames: int, seed: int) -> None:
    motion = np.random.default_rng(seed).normal(size=(num_frames, 3, 3)).astype(np.float32)
    back = to_motion(from_motion(motion, num_frames // 2 + 1), num_frames)
    np.testing.assert_allclose(back, motion, atol=1e-5)


@settings(max_examples=30)
@given(num_frames=st.integers(3, 200), data=st.data())
def test_a_sway_of_amplitude_a_has_2_c_k_equal_a_whatever_t(num_frames: int, data: st.DataObject) -> None:
    k = data.draw(st.integers(1, (num_frames - 1) // 2))
    phase = data.draw(st.floats(0, 6.28))
    sway = 0.7 * np.cos(2 * np.pi * k * np.arange(num_frames) / num_frames + phase)
    motion = np.broadcast_to(sway[:, None, None], (num_frames, 2, 3)).astype(np.float32)
    coefficients = from_motion(motion, num_frames // 2 + 1)
    np.testing.assert_allclose(2 * np.abs(coefficients[:, k]), 0.7, rtol=1e-4)
    np.testing.assert_allclose(np.angle(coefficients[:, k] * np.exp(-1j * phase)), 0, atol=1e-3)
    others = np.delete(np.abs(coefficients), k, axis=1)
    assert others.size == 0 or others.max() < 1e-5


@pytest.mark.parametrize("num_frames", [100, 61])
def test_the_formula_of_the_format_is_the_inverse_transform(rng, num_frames: int) -> None:
    """Re Σ_k w_k c_k e^{2πikn/T}, summed slowly."""
    coefficients = spectrum_of(rng)
    expected = np.zeros((num_frames, 7, 3))
    for n in range(num_frames):
        for k, w in enumerate(bin_weights(16, num_frames)):
            expected[n] += (w * coefficients[:, k] * np.exp(2j * np.pi * k * n / num_frames)).real
    np.testing.assert_allclose(to_motion(coefficients, num_frames), expected, atol=1e-5)


@pytest.mark.parametrize(("num_frequencies", "num_frames"), [(16, 100), (51, 100), (11, 20), (31, 61)])
def test_every_way_to_motion_agrees(rng, num_frequencies: int, num_frames: int) -> None:
    coefficients = spectrum_of(rng, num_frequencies=num_frequencies)
    if num_frequencies == num_frames // 2 + 1 and num_frames % 2 == 0:
        coefficients[:, -1].imag = 0
    motion = to_motion(coefficients, num_frames)
    phases = np.arange(num_frames) / num_frames
    for frame, one in zip(motion, iter_motion(coefficients, phases, num_frames), strict=True):
        np.testing.assert_allclose(one, frame, atol=2e-5)


def test_the_loop_is_exact(rng) -> None:
    coefficients = spectrum_of(rng)
    first, after = iter_motion(coefficients, np.array([0.0, 1.0]))
    np.testing.assert_allclose(after, first, atol=1e-5)
    step = np.abs(np.diff(to_motion(coefficients), axis=0)).max()
    last = to_motion(coefficients)[-1]
    assert np.abs(first - last).max() <= step  # the seam is no larger than any other step


@pytest.mark.parametrize(
    ("coefficients", "options", "message"),
    [
        (np.zeros((6, 16, 3)), {}, "6 rows of coefficients for 7 voxels"),
        (np.zeros((7, 0, 3)), {}, "0 frequencies"),
        (np.zeros((7, 16, 3)), {"num_frames": 29}, "1 to 15 are allowed"),
        (np.zeros((7, 16, 3)), {"fps": 0.0}, "fps is 0"),
        (np.zeros((7, 16, 3)), {"fps": np.inf}, "fps is inf"),
        (np.full((7, 16, 3), np.nan), {}, "not finite"),
    ],
)
def test_a_spectrum_that_cannot_be_is_refused(coefficients: np.ndarray, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SparseVoxelSpectrum(grid=small_grid(), coefficients=coefficients.astype(np.complex64), **options)
