"""Reference in Python for clients that evaluate endless wind themselves. Needs only numpy."""

from typing import Any

import numpy as np


def wave_at(wave: dict[str, Any], seconds: float) -> float:
    """Evaluate one of the waves `strength`, `lean` and `turn_rad`."""
    frequency_hz, amplitude, phase = (np.array(wave[name]) for name in ("frequency_hz", "amplitude", "phase_rad"))
    total = amplitude @ np.cos(2 * np.pi * frequency_hz * seconds + phase)
    return float(wave["mean"] + wave["limit"] * np.tanh(total / wave["limit"]))


def drag(speed_m_s: np.ndarray) -> np.ndarray:
    """Return the relative drag: speed^1.4 up to 12 m/s; above, where crowns streamline, proportional to the speed."""
    return speed_m_s * np.minimum(speed_m_s, 12) ** 0.4


def gains(bands: dict[str, Any], speed_m_s: float) -> np.ndarray:
    """Return the factor [K] on each coordinate for a mean wind speed: linear in the drag between the bands."""
    drags, now = drag(np.array(bands["speeds_m_s"])), drag(np.array(speed_m_s))
    return np.array([np.interp(now, drags, column) for column in np.array(bands["gains"]).T])


def coordinates(wind: dict[str, Any], seconds: float, speed_m_s: float | None = None) -> np.ndarray:
    """Return q [K] from the response of GET /v1/spectra/{id}/wind; a point moves by Rz(turn_rad) Re Σ_k φ_k q_k.

    `speed_m_s` is the current mean speed, by default the response's.
    """
    angle = 2 * np.pi * np.array(wind["partial_hz"]) * seconds + np.array(wind["partial_phase_rad"])  # [K - 1, J]
    sway = wave_at(wind["strength"], seconds) * np.exp(1j * angle).sum(axis=1) / np.sqrt(angle.shape[1])
    speed = wind["wind"]["speed_m_s"] if speed_m_s is None else speed_m_s
    return gains(wind["bands"], speed) * np.concatenate([[wave_at(wind["lean"], seconds)], sway])


def flutter(
    constants: dict[str, float],
    tones: np.ndarray,
    size: np.ndarray,
    axis: np.ndarray,
    direction: np.ndarray,
    seconds: float,
    air_speed_m_s: float,
) -> np.ndarray:
    """Return the flutter of leaves and twig ends as rotations θ of all bones [B, 3].

    `constants` are `flutter` of `wind.json`; `tones` [J, B, 3] and `size` [B, 2], critical speed and share, are parts
    of `bones.exr`. The speed of the air is the mean speed times strength^(1 / 1.4).
    """
    angle = 2 * np.pi * (tones[..., :1] * (seconds / constants["period_s"] % 1) + tones[..., 1:])  # [J, B, 2]
    flap, twist = (np.sqrt(0.5) * np.cos(angle) * (tones[..., :1] > 0)).sum(axis=0).T[..., None]
    over = np.maximum(air_speed_m_s / size[:, :1] - 1, 0)
    turn = constants["flap_rad"] * flap * axis + constants["twist_rad"] * twist * direction
    return np.asarray(size[:, 1:] * over**2 / (1 + over**2) * turn)


def half_turns(theta: np.ndarray, direction: np.ndarray, wind_turn: float, leaf: np.ndarray) -> np.ndarray:
    """Return turns of bones as axis times sine of half the angle [B, 3], +Z up, from Re Σ_k θ_k q_k [B, 3].

    `direction` are the bones' unit vectors. The end of a bone swings in the direction of the wind, which is
    rotated by `wind_turn`; `leaf` is the result of `flutter`.
    """
    cosine, sine = np.cos(wind_turn), np.sin(wind_turn)
    around = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    along = (theta * direction).sum(axis=1, keepdims=True) * direction
    theta = np.cross(direction, np.cross(theta, direction) @ around) + along + leaf
    c = 1 / np.sqrt(1 + (theta**2).sum(axis=1, keepdims=True))  # cosine of the angle, atan |θ|
    return theta * c / np.sqrt(2 + 2 * c)


def turned(half: np.ndarray, arm_m: np.ndarray) -> np.ndarray:
    """Rotate arms [N, 3] by turns from `half_turns` [N, 3]; their lengths stay."""
    real = np.sqrt(1 - (half**2).sum(axis=1, keepdims=True))
    return arm_m + 2 * np.cross(half, np.cross(half, arm_m) + real * arm_m)


def feet(half: np.ndarray, foot_m: np.ndarray, parent: np.ndarray) -> np.ndarray:
    """Return the displacement of each bone's foot [B, 3]; parents come before children, -1 is the ground."""
    above = np.maximum(parent, 0)
    arm = foot_m - foot_m[above]
    moved = turned(half[above], arm) - arm
    for bone in np.flatnonzero(parent >= 0):
        moved[bone] += moved[parent[bone]]
    return moved
