"""Evaluate endless wind yourself: the reference for clients, in Python. Needs numpy alone."""

from typing import Any

import numpy as np


def wave_at(wave: dict[str, Any], seconds: float) -> float:
    """One of `strength`, `lean` and `turn_rad`."""
    frequency_hz, amplitude, phase = (np.array(wave[name]) for name in ("frequency_hz", "amplitude", "phase_rad"))
    total = amplitude @ np.cos(2 * np.pi * frequency_hz * seconds + phase)
    return float(wave["mean"] + wave["limit"] * np.tanh(total / wave["limit"]))


def drag(speed_m_s: np.ndarray) -> np.ndarray:
    """Speed^1.4 up to 12 m/s; above, where crowns streamline, in proportion to the speed."""
    return speed_m_s * np.minimum(speed_m_s, 12) ** 0.4


def gains(bands: dict[str, Any], speed_m_s: float) -> np.ndarray:
    """Factor [K] on each coordinate in a wind of this mean speed: linear in the drag between the bands."""
    drags, now = drag(np.array(bands["speeds_m_s"])), drag(np.array(speed_m_s))
    return np.array([np.interp(now, drags, column) for column in np.array(bands["gains"]).T])


def coordinates(wind: dict[str, Any], seconds: float, speed_m_s: float | None = None) -> np.ndarray:
    """q [K] complex, of the answer of GET /v1/spectra/{id}/wind; a point moves by Rz(turn_rad) Re Σ_k φ_k q_k.

    `speed_m_s` is the mean speed now, by default the answer's.
    """
    angle = 2 * np.pi * np.array(wind["partial_hz"]) * seconds + np.array(wind["partial_phase_rad"])  # [K - 1, J]
    sway = wave_at(wind["strength"], seconds) * np.exp(1j * angle).sum(axis=1) / np.sqrt(angle.shape[1])
    speed = wind["wind"]["speed_m_s"] if speed_m_s is None else speed_m_s
    return gains(wind["bands"], speed) * np.concatenate([[wave_at(wind["lean"], seconds)], sway])


def half_turns(theta: np.ndarray, direction: np.ndarray, wind_turn: float) -> np.ndarray:
    """Turns of bones as axis times the sine of half the angle [B, 3], +Z up, for Re Σ_k θ_k q_k [B, 3].

    The end of a bone, whose unit vectors are `direction`, swings in the direction of the wind, which has
    turned by `wind_turn`.
    """
    cosine, sine = np.cos(wind_turn), np.sin(wind_turn)
    around = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    along = (theta * direction).sum(axis=1, keepdims=True) * direction
    theta = np.cross(direction, np.cross(theta, direction) @ around) + along
    c = 1 / np.sqrt(1 + (theta**2).sum(axis=1, keepdims=True))  # of the angle, atan |θ|
    return theta * c / np.sqrt(2 + 2 * c)


def turned(half: np.ndarray, arm_m: np.ndarray) -> np.ndarray:
    """Arms [N, 3] after turns as `half_turns` gives them [N, 3]: they keep their lengths."""
    real = np.sqrt(1 - (half**2).sum(axis=1, keepdims=True))
    return arm_m + 2 * np.cross(half, np.cross(half, arm_m) + real * arm_m)


def feet(half: np.ndarray, foot_m: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """How far the foot of each bone moves [B, 3]; parents come before children, -1 is the ground's."""
    above = np.maximum(parent, 0)
    arm = foot_m - foot_m[above]
    moved = turned(half[above], arm) - arm
    for bone in np.flatnonzero(parent >= 0):
        moved[bone] += moved[parent[bone]]
    return moved
