"""Loss of the amplitude network: four squared errors."""

from dataclasses import dataclass

import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.models.small.amplitude import floor_of

SEEN = 3e-5  # of the height at drag and gust 1: the least motion whose centroid and lean count
CENTROID_WEIGHT = 0.15
LEAN_WEIGHT = 0.5
OF_ALL = 0.1
"""Share of what a whole tree is off by in a bin, which is mostly the gusts' chance, and would be learnt by heart."""


@dataclass(frozen=True, kw_only=True)
class AmplitudeLosses:
    """Squared errors of a voxel against its tree, with a share of the tree's own: see `amplitude_losses`."""

    logarithmic: Float32[Tensor, ""]  # of ln A against ln |c|
    overall: Float32[Tensor, ""]  # of ln a
    centroid: Float32[Tensor, ""]  # of the mean bin
    lean: Float32[Tensor, ""]  # over its square

    def total(self) -> Float32[Tensor, ""]:
        """Weighted sum."""
        weighted: Tensor = self.logarithmic + self.overall + CENTROID_WEIGHT * self.centroid + LEAN_WEIGHT * self.lean
        return weighted


def amplitude_losses(
    lean: Float32[Tensor, "R 3"],
    log_amplitude: Float32[Tensor, "R J 3"],
    spectrum: Complex64[Tensor, "R K 3"],
    wind: Float32[Tensor, "R 2"],
    num_trees: int = 1,
) -> AmplitudeLosses:
    """Four squared errors of a predicted amplitude and lean, of rows of which each tree has as many, in turn.

    In logarithms every voxel and every frequency counts alike; what E ln |c| lacks to ln A is measured afterwards. The
    second adds what is seen most, the frequencies that carry the motion: a² = Σ A² is all of it. The third holds low
    against high frequencies where voxels move enough to be seen; without it, measured, the centroid is half lost.

    Args:
        lean: c_0 over the height.
        log_amplitude: ln A over the height.
        spectrum: the truth over the height, in the wind's frame.
        wind: ln speed and gust at each row.
        num_trees: that the rows are of.
    """
    floor, seen_from = floor_of(wind), floor_of(wind, SEEN)
    power = spectrum[:, 1:].abs().square()  # [R, J, 3]
    guessed_power = (2 * log_amplitude).exp()
    size = (power + floor[:, None, None] ** 2).log() / 2
    total = (power.sum(dim=(1, 2)) + floor**2).log() / 2
    guessed = guessed_power.sum(dim=(1, 2)).log() / 2
    truth = spectrum[:, 0].real
    seen = power.sum(dim=(1, 2)) > seen_from**2
    difference = _mean_bin(guessed_power.sum(dim=2)) - _mean_bin(power.sum(dim=2) + floor[:, None] ** 2)
    return AmplitudeLosses(
        logarithmic=_squared(log_amplitude - size, num_trees),
        overall=_squared(guessed - total, num_trees),
        centroid=_squared(difference * seen, num_trees),
        lean=((lean - truth).square().sum(dim=1) / (truth.square().sum(dim=1) + seen_from**2)).mean(),
    )


def _mean_bin(power: Float32[Tensor, "R J"]) -> Float32[Tensor, " R"]:
    bins = torch.arange(1, power.shape[1] + 1, dtype=power.dtype)
    mean: Tensor = (power * bins).sum(dim=1) / power.sum(dim=1)
    return mean


def _squared(error: Float32[Tensor, "*S"], num_trees: int) -> Float32[Tensor, ""]:
    by_tree = error.view(num_trees, -1, *error.shape[1:])
    of_all = by_tree.mean(dim=1, keepdim=True)
    mean: Tensor = (by_tree - of_all).square().mean() + OF_ALL * of_all.square().mean()
    return mean
