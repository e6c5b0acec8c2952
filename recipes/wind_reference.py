"""Evaluate endless wind yourself: the reference for clients, in Python. Needs numpy alone."""

from typing import Any

import numpy as np


def wave_at(wave: dict[str, Any], seconds: float) -> float:
    """One of `strength`, `lean` and `turn_rad`."""
    frequency_hz, amplitude, phase = (np.array(wave[name]) for name in ("frequency_hz", "amplitude", "phase_rad"))
    total = amplitude @ np.cos(2 * np.pi * frequency_hz * seconds + phase)
    return float(wave["mean"] + wave["limit"] * np.tanh(total / wave["limit"]))


def coordinates(wind: dict[str, Any], seconds: float) -> np.ndarray:
    """q [K] complex, of the answer of GET /v1/spectra/{id}/wind; a point moves by Rz(turn_rad) Re Σ_k φ_k q_k."""
    angle = 2 * np.pi * np.array(wind["partial_hz"]) * seconds + np.array(wind["partial_phase_rad"])  # [K - 1, J]
    sway = wave_at(wind["strength"], seconds) * np.exp(1j * angle).sum(axis=1) / np.sqrt(angle.shape[1])
    return np.concatenate([[wave_at(wind["lean"], seconds)], sway])
