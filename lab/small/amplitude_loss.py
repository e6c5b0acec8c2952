"""Loss of the amplitude network: four squared errors."""

from dataclasses import dataclass

import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.models.small.amplitude import floor_of

MIN_MOTION = 3e-5  # smallest motion whose centroid and lean count [share of the height at drag and gust 1]
CENTROID_WEIGHT = 0.15
LEAN_WEIGHT = 0.5
TREE_SHARE = 0.1
"""Weight of a whole tree's mean error in a bin, which is mostly random gusts and would be overfitted."""


@dataclass(frozen=True, kw_only=True)
class AmplitudeLosses:
    """Squared errors of voxels relative to their tree, plus a share of the tree's own error; see `amplitude_losses`."""

    logarithmic: Float32[Tensor, ""]  # error of ln A against ln |c|
    overall: Float32[Tensor, ""]  # error of ln a
    centroid: Float32[Tensor, ""]  # error of the mean bin
    lean: Float32[Tensor, ""]  # error of the lean, over its square

    def total(self) -> Float32[Tensor, ""]:
        """Return the weighted sum."""
        weighted: Tensor = self.logarithmic + self.overall + CENTROID_WEIGHT * self.centroid + LEAN_WEIGHT * self.lean
        return weighted


def amplitude_losses(
    lean: Float32[Tensor, "R 3"],
    log_amplitude: Float32[Tensor, "R J 3"],
    spectrum: Complex64[Tensor, "R K 3"],
    wind: Float32[Tensor, "R 2"],
    num_trees: int = 1,
) -> AmplitudeLosses:
    """Compute four squared errors of a predicted amplitude and lean. All trees have equally many, consecutive rows.

    In logarithms, every voxel and frequency counts equally; the difference of E ln |c| and ln A is measured afterwards.
    The second error weights the frequencies that carry the motion, since a² = Σ A². The third compares low with high
    frequencies in voxels that move visibly; without it, half of the centroid's accuracy is lost, as measured.

    Args:
        lean: c_0 over the height.
        log_amplitude: ln A over the height.
        spectrum: the truth over the height, in the wind's frame.
        wind: ln speed and gust at each row.
        num_trees: number of trees in the rows.
    """
    floor, least = floor_of(wind), floor_of(wind, MIN_MOTION)
    power = spectrum[:, 1:].abs().square()  # [R, J, 3]
    guessed_power = (2 * log_amplitude).exp()
    size = (power + floor[:, None, None] ** 2).log() / 2
    total = (power.sum(dim=(1, 2)) + floor**2).log() / 2
    guessed = guessed_power.sum(dim=(1, 2)).log() / 2
    truth = spectrum[:, 0].real
    seen = power.sum(dim=(1, 2)) > least**2
    difference = _mean_bin(guessed_power.sum(dim=2)) - _mean_bin(power.sum(dim=2) + floor[:, None] ** 2)
    return AmplitudeLosses(
        logarithmic=_squared(log_amplitude - size, num_trees),
        overall=_squared(guessed - total, num_trees),
        centroid=_squared(difference * seen, num_trees),
        lean=((lean - truth).square().sum(dim=1) / (truth.square().sum(dim=1) + least**2)).mean(),
    )


def _mean_bin(power: Float32[Tensor, "R J"]) -> Float32[Tensor, " R"]:
    bins = torch.arange(1, power.shape[1] + 1, dtype=power.dtype)
    mean: Tensor = (power * bins).sum(dim=1) / power.sum(dim=1)
    return mean


def _squared(error: Float32[Tensor, "*S"], num_trees: int) -> Float32[Tensor, ""]:
    by_tree = error.view(num_trees, -1, *error.shape[1:])
    of_all = by_tree.mean(dim=1, keepdim=True)
    mean: Tensor = (by_tree - of_all).square().mean() + TREE_SHARE * of_all.square().mean()
    return mean
