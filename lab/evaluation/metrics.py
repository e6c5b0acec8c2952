"""Error metrics of a motion against the true one, by vertex: functions of coefficients [N, K, 3] in metres."""

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Float64, Int32, Int64

from dynamictree.spectrum import bin_weights, to_motion
from lab.training.loss import LocalSmoothness, local_smoothness

FLOOR = 1e-5
"""Smallest size [share of the tree's height]; smaller ones are raised to it, so that the logarithm is finite."""
ROOT_SHARE = 0.02
"""Vertices in this lowest share of the height are roots."""


def amplitude(coefficients: Complex64[np.ndarray, "N K 3"]) -> Float64[np.ndarray, " N"]:
    """Return a(p) = √(Σ_{k≥1} 2 |c_k|²), the root of the displacement's variance [m]."""
    power = np.abs(coefficients[:, 1:].astype(np.complex128)) ** 2
    size: Float64[np.ndarray, " N"] = np.sqrt(2 * power.sum(axis=(1, 2)))
    return size


def log_amplitude_agreement(
    guess: Complex64[np.ndarray, "N K 3"], truth: Complex64[np.ndarray, "N K 3"], height_m: float
) -> tuple[float, float]:
    """Return correlation and RMSE of ln a over vertices, after subtraction of the median difference."""
    floor = FLOOR * height_m
    left, right = (np.log(np.maximum(amplitude(one), floor)) for one in (guess, truth))
    difference = left - right
    rmse = np.sqrt(np.mean((difference - np.median(difference)) ** 2))
    return float(np.corrcoef(left, right)[0, 1]), float(rmse)


def centroid(coefficients: Complex64[np.ndarray, "N K 3"]) -> Float64[np.ndarray, " N"]:
    """Return the energy-weighted mean bin of each vertex's motion: Σ k |c_k|² / Σ |c_k|²."""
    power = (np.abs(coefficients[:, 1:].astype(np.complex128)) ** 2).sum(axis=2)
    bins = np.arange(1, power.shape[1] + 1)
    mean: Float64[np.ndarray, " N"] = (power * bins).sum(axis=1) / np.maximum(power.sum(axis=1), 1e-30)
    return mean


def centroid_correlation(guess: Complex64[np.ndarray, "N K 3"], truth: Complex64[np.ndarray, "N K 3"]) -> float:
    """Return the correlation of `centroid` over the moving vertices."""
    moving = amplitude(truth) > 0.01 * amplitude(truth).max()
    return float(np.corrcoef(centroid(guess)[moving], centroid(truth)[moving])[0, 1])


def roughness(coefficients: Complex64[np.ndarray, "N K 3"], edges: Int32[np.ndarray, "E 2"]) -> float:
    """Return the mean of |c_i − c_j| over edges, divided by the mean of |c_i|; all k ≥ 1 are stacked."""
    moving = coefficients[:, 1:].reshape(len(coefficients), -1)
    steps = np.linalg.norm(moving[edges[:, 0]] - moving[edges[:, 1]], axis=1)
    return float(steps.mean() / np.linalg.norm(moving, axis=1).mean())


def phase_agreement(coefficients: Complex64[np.ndarray, "N K 3"], edges: Int32[np.ndarray, "E 2"]) -> float:
    """Return the mean of Re ⟨c_i, c_j⟩ / (|c_i| |c_j|) over edges; 1 if neighbours move as one."""
    moving = coefficients[:, 1:].reshape(len(coefficients), -1)
    first, second = moving[edges[:, 0]], moving[edges[:, 1]]
    sizes = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
    product = (first * second.conj()).real.sum(axis=1)
    return float((product[sizes > 0] / sizes[sizes > 0]).mean())


def smoothness_loss(
    coefficients: Complex64[np.ndarray, "V K 3"],
    neighbours: Int64[torch.Tensor, "V M"],
    distances: Float32[torch.Tensor, "V M"],
) -> float:
    """Return L_LSS, paper eq. 3, of voxels and their neighbours for k ≥ 1, over the mean size; 0 if all are alike.

    The paper's loss is in metres; divided by the size, a scaled-down motion is no smoother.
    """
    moving = torch.from_numpy(np.ascontiguousarray(coefficients[:, 1:].transpose(1, 0, 2)))  # [J, V, 3]
    parts = torch.cat([moving.real, moving.imag], dim=2)
    weights = LocalSmoothness()
    loss = sum(float(local_smoothness(part, neighbours, distances, weights=weights)) for part in parts)
    return loss / float(moving.abs().square().sum(dim=2).sqrt().mean(dim=1).sum())


def energy_by_frequency(coefficients: Complex64[np.ndarray, "N K 3"]) -> Float64[np.ndarray, " J"]:
    """Return the share of the motion's energy at each k ≥ 1."""
    power = (np.abs(coefficients[:, 1:].astype(np.complex128)) ** 2).sum(axis=(0, 2))
    shares: Float64[np.ndarray, " J"] = power / power.sum()
    return shares


def edge_stretch(
    coefficients: Complex64[np.ndarray, "N K 3"],
    vertices: Float32[np.ndarray, "N 3"],
    edges: Int32[np.ndarray, "E 2"],
    *,
    num_frames: int = 100,
) -> tuple[float, float]:
    """Return median and 99th percentile of |length / length at rest − 1| over all edges and frames."""
    rest = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    edges, rest = edges[rest > 0], rest[rest > 0]
    across = (vertices[edges[:, 0]] - vertices[edges[:, 1]]).astype(np.float32)
    stretches = [
        np.abs(np.linalg.norm(across + frame[edges[:, 0]] - frame[edges[:, 1]], axis=1) / rest - 1)
        for frame in to_motion(coefficients, num_frames)
    ]
    median, extreme = np.percentile(np.concatenate(stretches), [50, 99])
    return float(median), float(extreme)


def root_share(coefficients: Complex64[np.ndarray, "N K 3"], vertices: Float32[np.ndarray, "N 3"]) -> float:
    """Return an upper bound of the displacement of roots, over the tree's height."""
    height = np.ptp(vertices[:, 2])
    roots = coefficients[vertices[:, 2] <= vertices[:, 2].min() + ROOT_SHARE * height]
    weights = bin_weights(coefficients.shape[1], 100)[:, None]
    bound = np.linalg.norm((np.abs(roots) * weights).sum(axis=1), axis=1)
    return float(bound.max() / height)


def loop_jump(coefficients: Complex64[np.ndarray, "N K 3"], *, num_frames: int = 100) -> float:
    """Return the largest step from last to first frame over the largest step inside the loop; up to 1 is no jump."""
    motion = to_motion(coefficients, num_frames)
    inside = np.linalg.norm(np.diff(motion, axis=0), axis=2).max()
    return float(np.linalg.norm(motion[0] - motion[-1], axis=1).max() / inside)


def downwind_lean(
    coefficients: Complex64[np.ndarray, "N K 3"], vertices: Float32[np.ndarray, "N 3"], direction_deg: float
) -> float:
    """Return the mean downwind displacement of the upper half, over the tree's height."""
    height = np.ptp(vertices[:, 2])
    upper = vertices[:, 2] > vertices[:, 2].min() + height / 2
    angle = np.deg2rad(direction_deg)
    lean = coefficients[upper, 0].real @ np.array([np.cos(angle), np.sin(angle), 0])
    return float(lean.mean() / height)
