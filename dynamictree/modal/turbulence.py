"""Endless turbulent wind: coordinates of a spectrum's bins as functions of time, without periodicity or state.

The loop has q_k = exp(2πi f_k t) for every bin k ≥ 1 and q_0 = 1 for the lean. In turbulent wind

    q_k(t) = b_k g(t) J^-1/2 Σ_j exp(i (2π f_kj t + ψ_kj)),  q_0(t) = b_0 λ(t),
    u(p, t) = Rz(α(t)) Re Σ_k w_k c_k(p) q_k(t).

The J partials of a bin lie at the quantiles of a damped oscillator's line, of half-width ζ f_k about f_k. So each bin
is a narrow-band process of unit variance that retains the bin's amplitude and shape, with the phases between points.
Gusts too slow for the loop multiply the drag, (U(t) / U)^1.4: g(t) is their effect on the sway, smoothed over the
ring-down of the lowest bin and of unit mean square; λ(t) is the lean, of mean 1, with the resonance of the tree's
lowest natural frequency; α(t) is the rotation of the wind's direction; b_k is the gain of the mean speed, 1 at the
spectrum's own (`wind_bands`). g, λ and α are sums of M partials with equal shares of the von Kármán spectrum. A sum
of cosines is endless, bounded, reproducible in every language, and needs no state.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64

from dynamictree.modal.real_trees import natural_damping, natural_frequency_hz
from dynamictree.requests import Wind
from dynamictree.rotation import about_z
from dynamictree.spectrum import SparseVoxelSpectrum, bin_weights
from dynamictree.wind.air import turbulence_length_m
from dynamictree.wind_bands import DRAG_EXPONENT, WindBands

NUM_PARTIALS = 6
"""J, partials per bin; |q_k| is at most √J = 2.4 times its root mean square, times g."""
NUM_GUST_PARTIALS = 12
"""M, partials of the gusts."""
SLOWEST_HZ = 1 / 600  # period of ten minutes, over which a mean wind is defined
LARGEST_TURN_RAD = np.pi / 3
_CELLS = 64  # cells of the integrals over the spectrum, per partial


@dataclass(frozen=True, kw_only=True)
class Wave:
    """Bounded random function of time: mean + limit · tanh(Σ_m amplitude_m cos(2π f_m t + phase_m) / limit)."""

    mean: float
    limit: float
    frequency_hz: Float64[np.ndarray, " M"]
    amplitude: Float64[np.ndarray, " M"]
    phase_rad: Float64[np.ndarray, " M"]

    def at(self, times_s: Float64[np.ndarray, " T"]) -> Float64[np.ndarray, " T"]:
        """Evaluate the wave at each time."""
        angle = 2 * np.pi * np.outer(times_s, self.frequency_hz) + self.phase_rad
        return np.asarray(self.mean + self.limit * np.tanh(np.cos(angle) @ self.amplitude / self.limit))


@dataclass(frozen=True, kw_only=True)
class TurbulentWind:
    """Coordinates of K bins as functions of time, created by `turbulent_wind`."""

    seed: int
    wind: Wind
    frequencies_hz: Float64[np.ndarray, " K"]  # frequencies f_k of the loop
    natural_frequency_hz: float
    damping_ratio: float
    length_scale_m: float  # length scale of the turbulence
    partial_hz: Float64[np.ndarray, "K J"]  # f_kj; row 0 is unused, since the lean has no partials
    partial_phase_rad: Float64[np.ndarray, "K J"]
    strength: Wave  # g, the gusts' effect on the sway
    lean: Wave  # λ, the lean
    turn_rad: Wave  # α, the wind's direction
    bands: WindBands  # gain b by mean speed

    @property
    def bandwidth_hz(self) -> Float64[np.ndarray, " K"]:
        """Half-width of each bin's line at half of its power [Hz]."""
        return np.asarray(self.damping_ratio * self.frequencies_hz)

    def speeds_m_s(self, times_s: Float64[np.ndarray, " T"]) -> Float64[np.ndarray, " T"]:
        """Compute the speed of the air at each time, which has the gusts' strength as the effect of its drag."""
        return np.asarray(self.wind.speed_m_s * np.maximum(self.strength.at(times_s), 0) ** (1 / DRAG_EXPONENT))

    def coordinates(self, times_s: Float64[np.ndarray, " T"]) -> Complex128[np.ndarray, "T K"]:
        """Compute q_k at each time, for the mean speed of `wind`."""
        q = np.empty((len(times_s), len(self.frequencies_hz)), np.complex128)
        q[:, 0] = self.lean.at(times_s)
        strength = self.strength.at(times_s) / np.sqrt(self.partial_hz.shape[1])
        for k in range(1, q.shape[1]):
            angle = 2 * np.pi * np.outer(times_s, self.partial_hz[k]) + self.partial_phase_rad[k]
            q[:, k] = strength * np.exp(1j * angle).sum(axis=1)
        return np.asarray(q * self.bands.at(self.wind.speed_m_s))


def turbulent_wind(spectrum: SparseVoxelSpectrum, *, seed: int = 0, wind: Wind | None = None) -> TurbulentWind:
    """Create turbulent wind for a spectrum's bins; the same seed gives the same wind.

    The spectrum's height and foliage determine damping and natural frequency; `wind` is by default the spectrum's.
    """
    largest_gust = 0.9  # largest deviation of the drag's factor from 1
    slowest_wind_m_s = 0.5
    lateral_share = 0.75  # ratio of the speed's standard deviations across and along the mean wind, ESDU 85020
    rng = np.random.default_rng(seed)
    wind = wind or spectrum.wind or Wind()
    height = spectrum.grid.height_m
    damping, natural = natural_damping(spectrum.foliage), natural_frequency_hz(height, spectrum.foliage)
    fastest_gust_hz = 0.5 / spectrum.period_s  # faster gusts are in the spectrum
    length = turbulence_length_m(height)
    gusts = _gusts(max(wind.speed_m_s, slowest_wind_m_s) / length, fastest_gust_hz, wind.gust, rng)
    phase = rng.uniform(0, 2 * np.pi, (2, NUM_GUST_PARTIALS))  # phases of the speed, and of the direction
    resonance = gusts.filtered(lambda f: 1 / (1 - (f / natural) ** 2 + 2j * damping * f / natural))
    smoothing = gusts.filtered(lambda f: 1 / (1 + 1j * f / (damping * natural)))
    strength = gusts.wave(1.0, largest_gust, DRAG_EXPONENT * smoothing, phase[0])
    return TurbulentWind(
        seed=seed,
        wind=wind,
        frequencies_hz=spectrum.frequencies_hz,
        natural_frequency_hz=natural,
        damping_ratio=damping,
        length_scale_m=length,
        partial_hz=_partials(spectrum.frequencies_hz, damping, fastest_gust_hz, rng),
        partial_phase_rad=rng.uniform(0, 2 * np.pi, (spectrum.num_frequencies, NUM_PARTIALS)),
        strength=_to_unit_mean_square(strength),
        lean=gusts.wave(1.0, largest_gust, DRAG_EXPONENT * resonance, phase[0]),
        bands=spectrum.wind_bands,
        turn_rad=gusts.wave(0.0, LARGEST_TURN_RAD, lateral_share * resonance, phase[1]),
    )


def iter_turbulent_sums(
    coefficients: Complex64[np.ndarray, "N K 3"],
    wind: TurbulentWind,
    times_s: Float64[np.ndarray, " T"],
    num_frames: int,
) -> Iterator[tuple[Float32[np.ndarray, "N 3"], Float32[np.ndarray, "3 3"]]]:
    """Yield Re Σ_k w_k c_k q_k and the rotation of the wind's direction per moment; `num_frames` is the loop's T."""
    times_at_once = 240
    num_points, num_frequencies, _ = coefficients.shape
    stacked = np.concatenate([coefficients.real, -coefficients.imag], axis=1)  # [N, 2K, 3]
    stacked = np.ascontiguousarray(stacked.transpose(1, 0, 2)).reshape(2 * num_frequencies, num_points * 3)
    weights = bin_weights(num_frequencies, num_frames)
    for start in range(0, len(times_s), times_at_once):
        some = times_s[start : start + times_at_once]
        q = weights * wind.coordinates(some)
        coordinates = np.concatenate([q.real, q.imag], axis=1).astype(np.float32)  # [T, 2K]
        for row, turn in zip(coordinates, wind.turn_rad.at(some), strict=True):
            yield (row @ stacked).reshape(num_points, 3), about_z(float(turn))


@dataclass(frozen=True, kw_only=True)
class _Gusts:
    """Partials of the speed's slow fluctuation over its mean, with equal variances."""

    edges_hz: Float64[np.ndarray, "M cells"]  # frequencies at equal parts of the variance of each partial
    frequency_hz: Float64[np.ndarray, " M"]
    amplitude: float  # amplitude of each partial

    def filtered(
        self, transfer: Callable[[Float64[np.ndarray, "*shape"]], Complex128[np.ndarray, "*shape"]]
    ) -> Complex128[np.ndarray, " M"]:
        """Return each partial's transfer: magnitude averaged over its band, phase at its frequency."""
        size = np.sqrt((np.abs(transfer(self.edges_hz)) ** 2).mean(axis=1))
        return np.asarray(size * np.exp(1j * np.angle(transfer(self.frequency_hz))))

    def wave(
        self, mean: float, limit: float, transfer: Complex128[np.ndarray, " M"], phase_rad: Float64[np.ndarray, " M"]
    ) -> Wave:
        """Return the wave of these gusts after a filter."""
        return Wave(
            mean=mean,
            limit=limit,
            frequency_hz=self.frequency_hz,
            amplitude=self.amplitude * np.abs(transfer),
            phase_rad=(phase_rad + np.angle(transfer)) % (2 * np.pi),
        )


def _gusts(rate_hz: float, fastest_hz: float, gust: float, rng: np.random.Generator) -> _Gusts:
    """Split the von Kármán spectrum of a wind that carries `rate_hz` gusts per second past a point."""
    frequency = np.geomspace(SLOWEST_HZ, fastest_hz, 4096)
    density = 4 / rate_hz / (1 + 70.8 * (frequency / rate_hz) ** 2) ** (5 / 6)  # spectrum per variance [1/Hz]
    share = np.concatenate([[0], np.cumsum(np.diff(frequency) * (density[1:] + density[:-1]) / 2)])
    shares = (np.arange(NUM_GUST_PARTIALS * _CELLS) + 0.5) / (NUM_GUST_PARTIALS * _CELLS) * share[-1]
    cells = np.interp(shares, share, frequency).reshape(NUM_GUST_PARTIALS, _CELLS)
    chosen = rng.integers(_CELLS, size=NUM_GUST_PARTIALS)
    jitter = 1 + 1e-3 * rng.standard_normal(NUM_GUST_PARTIALS)  # jitter that avoids a common period
    return _Gusts(
        edges_hz=cells,
        frequency_hz=cells[np.arange(NUM_GUST_PARTIALS), chosen] * jitter,
        amplitude=gust * float(np.sqrt(2 * share[-1] / NUM_GUST_PARTIALS)),
    )


def _to_unit_mean_square(wave: Wave) -> Wave:
    """Scale a wave to unit mean square over time; a sum of this many cosines is close to normal."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(32)
    spread = np.sqrt((wave.amplitude**2).sum() / 2)
    values = wave.mean + wave.limit * np.tanh(spread * nodes / wave.limit)
    size = float(np.sqrt((weights * values**2).sum() / weights.sum()))
    return replace(wave, mean=wave.mean / size, limit=wave.limit / size, amplitude=wave.amplitude / size)


def _partials(
    frequencies_hz: Float64[np.ndarray, " K"], damping: float, reach_hz: float, rng: np.random.Generator
) -> Float64[np.ndarray, "K J"]:
    """Sample a frequency in each part of equal power of every bin's resonance line, cut at the next bin."""
    half_width = np.maximum(damping * frequencies_hz, 1e-9)[:, None]
    share = (np.arange(NUM_PARTIALS) + rng.uniform(0, 1, (len(frequencies_hz), NUM_PARTIALS))) / NUM_PARTIALS
    offset = half_width * np.tan((2 * share - 1) * np.arctan(reach_hz / half_width))
    return np.asarray(frequencies_hz[:, None] + offset)
