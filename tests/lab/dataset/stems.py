"""Lengths, radii, frequencies and amplitudes of a tree's stems, measured on the motion."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int8

from dynamictree.spectrum import FPS, NUM_FREQUENCIES
from lab.dataset.sample import Sample


@dataclass(frozen=True, kw_only=True)
class StemTable:
    """One row per stem."""

    level: Int8[np.ndarray, " S"]
    length_m: Float32[np.ndarray, " S"]
    radius_m: Float32[np.ndarray, " S"]  # radius at the base
    frequency_hz: Float32[np.ndarray, " S"]  # where the tip turns fastest against the base; 0 if it does not turn
    amplitude_rad: Float32[np.ndarray, " S"]  # root mean square of that turning
    first_bins_share: float  # share of the displacement's energy, with the mean


def tables_of(sample: Sample) -> StemTable:
    """Measure one tree."""
    skeleton = sample.skeleton
    num_nodes = len(skeleton.position)
    tip = np.zeros(len(skeleton.stem_length_m), np.int64)
    tip[skeleton.stem] = np.arange(num_nodes)  # a stem's last node stands last
    base = np.zeros_like(tip)
    base[skeleton.stem[::-1]] = np.arange(num_nodes)[::-1]
    hanging = skeleton.parent[base]
    turn = sample.motion.turn + np.eye(3, dtype=np.float32)
    frequency_hz, amplitude_rad = bending(turn[:, np.where(hanging < 0, base, hanging)], turn[:, tip])
    return StemTable(
        level=skeleton.level[base],
        length_m=skeleton.stem_length_m,
        radius_m=skeleton.radius[base],
        frequency_hz=frequency_hz,
        amplitude_rad=amplitude_rad,
        first_bins_share=first_bins_share(sample.motion.shift),
    )


def bending(
    base: Float32[np.ndarray, "T S 3 3"], tip: Float32[np.ndarray, "T S 3 3"]
) -> tuple[Float32[np.ndarray, " S"], Float32[np.ndarray, " S"]]:
    """Frequency [Hz] and amplitude [rad] of the tip's turning against the base, from rotations."""
    relative = np.einsum("tsji,tsjk->tsik", base, tip)
    across = (relative - relative.swapaxes(2, 3)) / 2
    vector = across[..., [2, 0, 1], [1, 2, 0]]  # rotation vector, for small angles
    power = (np.abs(np.fft.rfft(vector, axis=0, norm="forward")) ** 2).sum(axis=2)  # [T // 2 + 1, S]
    frequency = np.fft.rfftfreq(len(vector), d=1 / FPS)
    fastest = (power * frequency[:, None] ** 2).argmax(axis=0)
    return frequency[fastest].astype(np.float32), np.sqrt(2 * power[1:].sum(axis=0)).astype(np.float32)


def first_bins_share(displacement: Float32[np.ndarray, "T N 3"]) -> float:
    """Share of a motion's energy that its first K coefficients hold."""
    power = (np.abs(np.fft.rfft(displacement, axis=0)) ** 2).sum(axis=(1, 2))
    power[1:] *= 2
    return float(power[:NUM_FREQUENCIES].sum() / power.sum())
