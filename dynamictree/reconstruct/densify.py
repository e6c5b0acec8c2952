"""Adaptive density control: split, clone and prune Gaussians. Kerbl et al. 2023, section 5."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.spatial import cKDTree

from dynamictree.reconstruct.adam import AdamState
from dynamictree.reconstruct.splat_table import LOG_SCALE, LOGIT, MEAN, QUATERNION
from dynamictree.rotation import quaternion_matrices

_SMALLER = np.float32(np.log(1.6))  # φ of Kerbl et al.: halves of a split Gaussian are narrower by it


@dataclass(frozen=True, kw_only=True)
class DensityRules:
    """Thresholds for splitting, cloning and pruning: Kerbl et al.'s, with half their gradient threshold."""

    pull: float = 1e-4  # mean gradient of the loss by the place, in half pictures, above which one is not enough
    large: float = 0.01  # of the extent: a larger one is split, a smaller one gets a twin
    min_opacity: float = 0.005
    too_large: float = 0.1  # of the extent, or of the distance from the origin for what is farther away
    max_gaussians: int = 60_000
    free_distance: float = 0.08  # of the cameras' median distance from the origin: nothing is so near to a camera


class Pull:
    """Mean length of the gradient by the place in the picture, over the views that see a Gaussian."""

    def __init__(self, number: int) -> None:
        self.total: Float32[np.ndarray, " G"] = np.zeros(number, np.float32)
        self.times: Float32[np.ndarray, " G"] = np.zeros(number, np.float32)

    def add(
        self, centres_px: Float32[np.ndarray, "G 2"], seen: Bool[np.ndarray, " G"], width: int, height: int
    ) -> None:
        """Add the gradients of one view."""
        half_width, half_height = np.float32(0.5 * width), np.float32(0.5 * height)
        self.total += np.hypot(half_width * centres_px[:, 0], half_height * centres_px[:, 1])
        self.times += seen

    @property
    def mean(self) -> Float32[np.ndarray, " G"]:
        """Mean over the views; zero for Gaussians that were never seen."""
        mean: Float32[np.ndarray, " G"] = self.total / np.maximum(self.times, 1)
        return mean


def densified(
    table: Float32[np.ndarray, "G P"],
    moments: AdamState,
    pull: Float32[np.ndarray, " G"],
    rules: DensityRules,
    *,
    extent: float,
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "G2 P"], AdamState]:
    """Split the large and clone the small Gaussians with the largest gradients, within the budget; then prune."""
    largest = np.exp(table[:, LOG_SCALE].max(axis=1))
    reach = np.maximum(extent, np.linalg.norm(table[:, MEAN], axis=1))
    survives = (_opacity(table) > rules.min_opacity) & (largest < rules.too_large * reach)
    room = rules.max_gaussians - int(survives.sum())
    chosen = np.flatnonzero(survives & (pull > rules.pull))
    if len(chosen) > max(room, 0):
        chosen = chosen[np.argsort(-pull[chosen], kind="stable")[: max(room, 0)]]
    split = chosen[largest[chosen] > rules.large * reach[chosen]]
    twins = table[np.setdiff1d(chosen, split)]
    halves = np.concatenate([_half(table[split], rng), _half(table[split], rng)])
    survives[split] = False
    new = np.concatenate([twins, halves])
    rows = np.flatnonzero(survives)
    return np.concatenate([table[rows], new]), moments.rows(rows, len(new))


def before_cameras(
    table: Float32[np.ndarray, "G P"], cameras: Float64[np.ndarray, "V 3"], rules: DensityRules
) -> Bool[np.ndarray, " G"]:
    """Gaussians where a camera was: one photo alone shows them, as fog in all others from near there."""
    free = rules.free_distance * float(np.median(np.linalg.norm(cameras, axis=1)))
    distance = np.asarray(cKDTree(cameras).query(table[:, MEAN], distance_upper_bound=free)[0])
    near: Bool[np.ndarray, " G"] = np.isfinite(distance)
    return near


def fainter(table: Float32[np.ndarray, "G P"], moments: AdamState, opacity: float = 0.01) -> None:
    """Reset opacity, in place: Gaussians that the photos need become opaque again, floaters do not."""
    limit = np.float32(np.log(opacity / (1 - opacity)))
    table[:, LOGIT] = np.minimum(table[:, LOGIT], limit)
    moments.first[:, LOGIT] = 0
    moments.second[:, LOGIT] = 0


def _half(rows: Float32[np.ndarray, "S P"], rng: np.random.Generator) -> Float32[np.ndarray, "S P"]:
    """Sample a narrower Gaussian inside each row's Gaussian."""
    half = rows.copy()
    if len(rows):
        offset = rng.normal(size=(len(rows), 3)) * np.exp(rows[:, LOG_SCALE])
        half[:, MEAN] += np.einsum("gij,gj->gi", quaternion_matrices(rows[:, QUATERNION]), offset).astype(np.float32)
    half[:, LOG_SCALE] -= _SMALLER
    return half


def _opacity(table: Float32[np.ndarray, "G P"]) -> Float32[np.ndarray, " G"]:
    opacity: Float32[np.ndarray, " G"] = 1 / (1 + np.exp(-table[:, LOGIT]))
    return opacity
