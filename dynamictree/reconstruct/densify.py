"""Adaptive density control: split, clone and prune Gaussians. Kerbl et al. 2023, section 5."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import LOG_SCALE, LOGIT, MEAN, QUATERNION
from dynamictree.rotation import quaternion_matrices

_NARROWER = np.float32(np.log(1.6))  # φ of Kerbl et al.: factor by which the halves of a split Gaussian are narrower


@dataclass(frozen=True, kw_only=True)
class DensityRules:
    """Thresholds for splitting, cloning and pruning: Kerbl et al.'s, with half their gradient threshold."""

    pull: float = 1e-4  # mean gradient by position [1 / half a picture] above which to split or clone
    large: float = 0.01  # share of the extent; larger Gaussians are split, smaller ones cloned
    min_opacity: float = 0.005
    too_large: float = 0.1  # share of the extent, or of the distance from the origin if that is larger; pruned above
    max_gaussians: int = 80_000


def densify(state: SplatState, rules: DensityRules, *, extent: float, rng: np.random.Generator) -> None:
    """Split the large and clone the small Gaussians with the largest gradients, within the budget; then prune."""
    table, pull = state.table, state.mean_pull
    opacity, largest = 1 / (1 + np.exp(-table[:, LOGIT])), np.exp(table[:, LOG_SCALE].max(axis=1))
    reach = np.maximum(extent, np.linalg.norm(table[:, MEAN], axis=1))
    survives = (opacity > rules.min_opacity) & (largest < rules.too_large * reach)
    room = max(rules.max_gaussians - int(survives.sum()), 0)
    chosen = np.flatnonzero(survives & (pull > rules.pull))
    if len(chosen) > room:  # Gaussians of the subject (central, above the ground) have fourfold priority
        x, y, z = table[chosen, MEAN].T
        first = pull[chosen] * np.where((np.hypot(x, y) < 0.75) & (z > 0.02), 4, 1)
        chosen = chosen[np.argsort(-first, kind="stable")[:room]]
    split = chosen[largest[chosen] > rules.large * reach[chosen]]
    halves = [_narrower_sample(table[split], rng) for _ in range(2)]
    survives[split] = False
    state.keep(np.flatnonzero(survives), np.concatenate([table[np.setdiff1d(chosen, split)], *halves]))


def _narrower_sample(rows: Float32[np.ndarray, "S P"], rng: np.random.Generator) -> Float32[np.ndarray, "S P"]:
    """Sample a narrower Gaussian inside each row's Gaussian."""
    half = rows.copy()
    offset = rng.normal(size=(len(rows), 3)) * np.exp(rows[:, LOG_SCALE])
    half[:, MEAN] += np.einsum("gij,gj->gi", quaternion_matrices(rows[:, QUATERNION]), offset).astype(np.float32)
    half[:, LOG_SCALE] -= _NARROWER
    return half
