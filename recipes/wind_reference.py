"""Evaluate endless wind yourself: the reference for clients, in Python. Needs numpy alone."""

from typing import Any

import numpy as np


def wave_at(wave: dict[str, Any], seconds: float) -> float:
    """One of `strength`, `lean` and `turn_rad`."""
    frequency_hz, amplitude, phase = (np.array(wave[name]) for name in ("frequency_hz", "amplitude", "phase_rad"))
    total = amplitude @ np.cos(2 * np.pi * frequency_hz * seconds + phase)
    return float(wave["mean"] + wave["limit"] * np.tanh(total / wave["limit"]))


def gains(bands: dict[str, Any], speed_m_s: float) -> np.ndarray:
    """Factor [K] on each coordinate in a wind of this mean speed: linear in speed^1.4 between the bands."""
    drag = np.array(bands["speeds_m_s"]) ** 1.4
    return np.array([np.interp(speed_m_s**1.4, drag, column) for column in np.array(bands["gains"]).T])


def coordinates(wind: dict[str, Any], seconds: float, speed_m_s: float | None = None) -> np.ndarray:
    """q [K] complex, of the answer of GET /v1/spectra/{id}/wind; a point moves by Rz(turn_rad) Re Σ_k φ_k q_k.

    `speed_m_s` is the mean speed now, by default the answer's.
    """
    angle = 2 * np.pi * np.array(wind["partial_hz"]) * seconds + np.array(wind["partial_phase_rad"])  # [K - 1, J]
    sway = wave_at(wind["strength"], seconds) * np.exp(1j * angle).sum(axis=1) / np.sqrt(angle.shape[1])
    speed = wind["wind"]["speed_m_s"] if speed_m_s is None else speed_m_s
    return gains(wind["bands"], speed) * np.concatenate([[wave_at(wind["lean"], seconds)], sway])


def turned(theta: np.ndarray, arm_m: np.ndarray) -> np.ndarray:
    """Arms [N, 3] from the pivots of leaf cards, turned by atan |θ| about θ [N, 3]: they keep their lengths."""
    c = 1 / np.sqrt(1 + (theta**2).sum(axis=1, keepdims=True))
    along = (theta * arm_m).sum(axis=1, keepdims=True)
    return c * arm_m + c * np.cross(theta, arm_m) + c**2 / (1 + c) * along * theta
