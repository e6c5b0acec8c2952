"""Sparse voxel spectrum: K frequencies of motion per voxel, and conversion to and from motion. Paper section 3.2.

A coefficient is a length in metres (`norm="forward"`). The displacement at frame n, time n / fps, is

    d_n = Re Σ_k w_k c_k exp(2πi k n / T),    w_k = 1 for k = 0 and, T even, for k = T / 2, else 2.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Complex64, Float32, Float64, Int16, Int32

from dynamictree.errors import InputError
from dynamictree.requests import Wind as Wind
from dynamictree.source import Source
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.wind_bands import WindBands, power_law

NUM_FREQUENCIES = 16  # K, paper section 3.2
NUM_FRAMES = 100  # T, paper section 5
FPS = 24.0  # Blender's default, in which the paper's dataset was baked
STEPS = 32767  # largest value of quantised numbers in 16 bits
_FRAMES_AT_ONCE, _VALUES_AT_ONCE = 16, 4_000_000

UNKNOWN_FOLIAGE = 0.6
"""Foliage where neither request nor shape gives it: a damping ratio of 0.08, between bare trees and trees in leaf."""

Rest = Literal["unloaded", "first-frame", "mean"]


@dataclass(frozen=True, kw_only=True)
class SparseVoxelSpectrum:
    """One spectrum per voxel, in the order of `grid.coords`."""

    grid: VoxelGrid
    coefficients: Complex64[np.ndarray, "V K 3"]  # [m]
    tree: Int32[np.ndarray, " V"] | None = None  # index of the voxel's tree; None if there is one
    fps: float = FPS
    num_frames: int = NUM_FRAMES
    rest: Rest = "unloaded"  # meaning of zero displacement; by default c_0 is the lean
    model: str = ""
    seed: int = 0
    wind: Wind | None = None
    foliage: float | None = None  # foliage of the tree: 0 is bare, 1 in leaf; None if unknown
    bands: WindBands | None = None  # gains of its modes in other winds, if the model generated them
    source: Source = field(default_factory=Source)

    def __post_init__(self) -> None:
        if len(self.coefficients) != len(self.grid):
            raise InputError(
                f"{len(self.coefficients)} rows of coefficients for {len(self.grid)} voxels; they must be equal"
            )
        if self.tree is not None and len(self.tree) != len(self.grid):
            raise InputError(f"{len(self.tree)} numbers of trees for {len(self.grid)} voxels; they must be equal")
        if not 1 <= self.num_frequencies <= self.num_frames // 2 + 1:
            allowed = f"1 to {self.num_frames // 2 + 1} are allowed with {self.num_frames} frames"
            raise InputError(f"the spectrum has {self.num_frequencies} frequencies; {allowed}")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise InputError(f"fps is {self.fps}; it must be positive and finite")
        if self.foliage is not None and not 0 <= self.foliage <= 1:
            raise InputError(f"foliage is {self.foliage}; 0 (bare) to 1 (in leaf) are allowed")
        if not np.isfinite(self.coefficients).all():
            raise InputError("the spectrum holds values that are not finite")
        if self.bands is not None and self.bands.num_frequencies != self.num_frequencies:
            count = self.bands.num_frequencies
            raise InputError(f"the wind bands have {count} frequencies, the spectrum {self.num_frequencies}")

    @property
    def num_frequencies(self) -> int:
        """Number of frequencies, K."""
        return int(self.coefficients.shape[1])

    @property
    def wind_bands(self) -> WindBands:
        """Gains of the modes in other winds: the model's, or a power law where it generated none."""
        own = (self.wind or Wind()).speed_m_s
        return self.bands or power_law(own, self.num_frequencies)

    @property
    def num_bytes(self) -> int:
        """Size of the arrays in memory [bytes]."""
        return self.coefficients.nbytes + self.grid.coords.nbytes

    @property
    def period_s(self) -> float:
        """Length of the loop [s]."""
        return self.num_frames / self.fps

    @property
    def frequencies_hz(self) -> Float64[np.ndarray, " K"]:
        """Frequency of each bin, k / period [Hz]."""
        return np.arange(self.num_frequencies) / self.period_s


def bin_weights(num_frequencies: int, num_frames: int) -> Float32[np.ndarray, " K"]:
    """Return w_k: how often each bin of the half spectrum occurs in the full spectrum."""
    weights = np.full(num_frequencies, 2.0, np.float32)
    weights[0] = 1.0
    if num_frames % 2 == 0 and num_frequencies > num_frames // 2:
        weights[num_frames // 2] = 1.0
    return weights


def quantise(modes: Complex64[np.ndarray, "N M 3"]) -> tuple[Int16[np.ndarray, "N M 3 2"], Float32[np.ndarray, " M"]]:
    """Quantise modes to 16 bits; return them and the step size of each."""
    parts = np.stack([modes.real, modes.imag], axis=-1)
    step = np.maximum(np.abs(parts).max(axis=(0, 2, 3), initial=0) / STEPS, np.finfo(np.float32).tiny)  # [M]
    return np.clip(np.rint(parts / step[:, None, None]), -STEPS, STEPS).astype(np.int16), step


def from_motion(
    displacement: Float32[np.ndarray, "T N 3"], num_frequencies: int = NUM_FREQUENCIES
) -> Complex64[np.ndarray, "N K 3"]:
    """Compute the first K coefficients of each point's motion [m]. `to_motion` is the inverse if K = T // 2 + 1."""
    # norm="forward": a coefficient is a length in metres, whatever the number of frames
    spectrum = np.fft.rfft(displacement, axis=0, norm="forward")[:num_frequencies]  # [K, N, 3]
    return np.ascontiguousarray(spectrum.transpose(1, 0, 2).astype(np.complex64))


def to_motion(
    coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int = NUM_FRAMES
) -> Float32[np.ndarray, "T N 3"]:
    """Displacement of each point at every frame of one period [m]. iFFT of paper eq. 1."""
    spectrum = coefficients.transpose(1, 0, 2)  # [K, N, 3]
    return np.fft.irfft(spectrum, n=num_frames, axis=0, norm="forward").astype(np.float32)


def iter_motion(
    coefficients: Complex64[np.ndarray, "N K 3"], phases: Float64[np.ndarray, " M"], num_frames: int = NUM_FRAMES
) -> Iterator[Float32[np.ndarray, "N 3"]]:
    """Yield displacements frame by frame; only a few frames are in memory at once [m]."""
    num_points, num_frequencies, _ = coefficients.shape
    # real part of a complex sum as one real product: [cos, -sin] · [re, im]
    stacked = np.concatenate([coefficients.real, coefficients.imag], axis=1)  # [N, 2K, 3]
    stacked = np.ascontiguousarray(stacked.transpose(1, 0, 2)).reshape(2 * num_frequencies, num_points * 3)
    weights = bin_weights(num_frequencies, num_frames)
    at_once = int(np.clip(_VALUES_AT_ONCE // max(3 * num_points, 1), 1, _FRAMES_AT_ONCE))
    for start in range(0, len(phases), at_once):
        angle = 2 * np.pi * np.outer(phases[start : start + at_once], np.arange(num_frequencies))
        turns = np.concatenate([weights * np.cos(angle), -weights * np.sin(angle)], axis=1).astype(np.float32)
        yield from (turns @ stacked).reshape(-1, num_points, 3)


def mode_sizes(coefficients: Complex64[np.ndarray, "V K 3"]) -> Float64[np.ndarray, " K"]:
    """Root mean square of each bin over the voxels [m]."""
    power = np.square(np.abs(coefficients), dtype=np.float64).sum(axis=2)
    return np.asarray(np.sqrt(power.mean(axis=0)))
