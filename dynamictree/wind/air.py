"""Turbulent air around a tree: a random velocity field that is periodic in time.

At each bin the velocity is a complex normal field: its amplitude is random, so that there are gusts and lulls, and
points at distance d have Davenport's root coherence exp(-c f d / U). The field is a sum of plane waves whose wave
vectors have a Cauchy distribution, the spectral density of that exponential. It travels downwind at the mean speed
(Taylor's frozen turbulence). The von Kármán spectrum distributes the variance of the gusts over the bins.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.requests import Wind
from dynamictree.rotation import about_z

DECAY_ACROSS, DECAY_ALONG = 10.0, 3.0
"""Decay c of Davenport's coherence; measured: 8 to 15 across the wind and 2 to 10 along it (Davenport 1961)."""
COMPONENTS = np.array([1.0, 0.75, 0.5])
"""Standard deviations along the wind, across it and vertical, relative to that along it. ESDU 85020."""
SKEW = 0.1
"""s of x + s (x² - 1), which replaces a normal x and has skewness 6 s. At the top of canopies 0.5 to 1 was measured
(Raupach, Finnigan and Brunet 1996): gusts are shorter and stronger than lulls."""
ROUGHNESS_M = 0.3
"""Roughness length of open country with trees and hedges, EN 1991-1-4."""
GUST_M_S, GUST_LENGTH_S = 3.0, 1.0  # speed and duration of a single gust


@dataclass(frozen=True, kw_only=True)
class Air:
    """Sample of the velocity field, created by `turbulent_air`."""

    wind: Wind
    frequency_hz: Float64[np.ndarray, " J"]
    axes: Float32[np.ndarray, "3 3"]  # rows: downwind, horizontally across and up
    wave: Float32[np.ndarray, "J F 3"]  # wave vectors [rad/m]
    size: Complex64[np.ndarray, "J F 3"]  # amplitude of each wave [m/s], in wind axes
    ticks: Float32[np.ndarray, "D T"]  # matrix from re and im of the bins to frames

    def velocity(self, points: Float32[np.ndarray, "M 3"]) -> Float32[np.ndarray, "3 M T"]:
        """Compute the velocity minus the mean at points, for every frame [m/s]; x, y, z."""
        phase = np.einsum("mx,jfx->jmf", points, self.wave, optimize=True)
        waves = np.cos(phase) + 1j * np.sin(phase)  # [J, M, F]
        hat = (waves @ self.size).transpose(2, 1, 0)  # [3, M, J]
        series = np.concatenate([hat.real, hat.imag], axis=2) @ self.ticks  # [3, M, T], in wind axes
        spread = self.wind.gust * self.wind.speed_m_s
        if spread > 0:
            along = series[0] / spread
            series[0] += np.float32(spread * SKEW) * (along * along - 1)
        velocity: Float32[np.ndarray, "3 M T"] = np.einsum("cx,cmt->xmt", self.axes, series, optimize=True)
        return velocity.astype(np.float32, copy=False)


def turbulent_air(
    wind: Wind,
    height_m: float,
    frequency_hz: Float64[np.ndarray, " J"],
    times_s: Float64[np.ndarray, " T"],
    rng: np.random.Generator,
) -> Air:
    """Sample a field whose gusts have the given frequencies, one or more above 0, and lengths by the tree's height.

    The wind's gust is the standard deviation of the speed over the mean.
    """
    num_waves = 64  # number per bin; one sample's coherence has an rms error of 1 / √64
    slowest_carrier_m_s = 1.0  # slowest speed of the field, which limits its phase in a calm
    axes = about_z(math.radians(wind.direction_deg)).T
    carrier = max(wind.speed_m_s, slowest_carrier_m_s)
    shape = (len(frequency_hz), num_waves)
    cauchy = rng.standard_normal((*shape, 3)) / np.abs(rng.standard_normal((*shape, 1)))
    decay = np.array([DECAY_ALONG, DECAY_ACROSS, DECAY_ACROSS]) / carrier * frequency_hz[:, None, None]
    wave = cauchy * decay  # [J, F, 3], in wind axes
    wave[:, :, 0] -= 2 * np.pi * frequency_hz[:, None] / carrier  # delay downwind
    chance = rng.standard_normal((*shape, 3, 2)) @ [1, 1j]
    power = von_karman_shares(frequency_hz, turbulence_length_m(height_m) / carrier)
    spread = np.sqrt(power[:, None] / 4 / num_waves)[:, :, None] * COMPONENTS * wind.gust * wind.speed_m_s
    turn = 2 * np.pi * np.outer(frequency_hz, times_s)
    return Air(
        wind=wind,
        frequency_hz=frequency_hz,
        axes=axes,
        wave=(wave @ axes).astype(np.float32),
        size=(spread * chance).astype(np.complex64),
        ticks=(2 * np.concatenate([np.cos(turn), -np.sin(turn)])).astype(np.float32),
    )


def single_gust(times_s: Float64[np.ndarray, " T"], speed_m_s: float = GUST_M_S) -> Air:
    """Create still air with one gust along +x at time 0, everywhere at once, GUST_LENGTH_S long; repeats after T."""
    period_s = times_s[1] * len(times_s)
    frequency_hz = np.arange(1, len(times_s) // 2) / period_s
    spectrum = np.exp(-((np.pi * frequency_hz * GUST_LENGTH_S / 2) ** 2)) * GUST_LENGTH_S / period_s
    size = np.zeros((len(frequency_hz), 1, 3), np.complex64)
    size[:, 0, 0] = speed_m_s * np.sqrt(np.pi) / 2 * spectrum
    turn = 2 * np.pi * np.outer(frequency_hz, times_s)
    return Air(
        wind=Wind(speed_m_s=0.0, gust=0.0),
        frequency_hz=frequency_hz,
        axes=np.eye(3, dtype=np.float32),
        wave=np.zeros((len(frequency_hz), 1, 3), np.float32),
        size=size,
        ticks=(2 * np.concatenate([np.cos(turn), -np.sin(turn)])).astype(np.float32),
    )


def von_karman_shares(frequency_hz: Float64[np.ndarray, " J"], duration_s: float) -> Float64[np.ndarray, " J"]:
    """Return the share of variance at each frequency; `duration_s` is the passing time of a gust, length over speed."""
    density = (1 + 70.8 * (frequency_hz * duration_s) ** 2) ** (-5 / 6)
    shares: Float64[np.ndarray, " J"] = density / density.sum()
    return shares


def turbulence_length_m(height_m: float) -> float:
    """Return the turbulence length scale at the top of a tree [m]; EN 1991-1-4, annex B."""
    return float(300 * (max(height_m, 2.0) / 200) ** (0.67 + 0.05 * np.log(ROUGHNESS_M)))
