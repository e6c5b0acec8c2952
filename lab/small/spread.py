"""Measure how far sizes lie from what the amplitude network says, on trees that it did not learn from."""

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from dynamictree.models.small.amplitude import floor_of
from dynamictree.models.small.generate import SmallModel
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.spread import log_surplus, speed_terms
from dynamictree.models.wind import wind_axes
from lab.dataset.shards import StoredTree
from lab.small.examples import voxels_of
from lab.small.training_steps import VOXELS_A_TREE, AmplitudeRows

MAX_SPREAD = 4.0


@torch.no_grad()
def measure_spread(network: SmallNetwork, rows: AmplitudeRows) -> None:
    """Set the network's spread, and the energy gain that gives the typical tree the energy it has.

    A tree's energy over A² varies about its trend with the speed, in the simulator as in what is drawn: the spread
    gives the mean energy, the gain takes the mean back to the mean of logarithms.
    """
    ratios = []
    for own in torch.split(torch.arange(len(rows)), VOXELS_A_TREE):
        _, log_amplitude = network.amplitude(rows.inputs[own].float(), rows.wind[own])
        power = rows.spectrum(own)[:, 1:].abs().square() + floor_of(rows.wind[own])[:, None, None] ** 2
        ratios.append(power.sum(dim=0) / (2 * log_amplitude).exp().sum(dim=0))
    log_speed = rows.wind[::VOXELS_A_TREE, 0]
    ratio, terms = torch.stack(ratios).flatten(1), speed_terms(log_speed)
    fitted = torch.linalg.pinv(terms) @ ratio.log()
    fitted[0] += (ratio / (terms @ fitted).exp()).mean(dim=0).log()
    spreads = np.linspace(0, MAX_SPREAD, 1000, dtype=np.float32)
    grid = speed_terms(torch.linspace(0, float(rows.wind[:, 0].max()), 100))
    spread = torch.from_numpy(
        np.interp(grid @ fitted, log_surplus(torch.from_numpy(spreads)), spreads).astype(np.float32)
    )
    network.spread.copy_((torch.linalg.pinv(grid) @ spread).view(network.spread.shape))
    expected = torch.stack([log_surplus(network.spread_at(one)).flatten() for one in log_speed])
    network.energy_gain.copy_(((ratio.log() - expected).mean(dim=0) / 2).exp().view(network.energy_gain.shape))


@torch.no_grad()
def measure_field(network: SmallNetwork, trees: Iterable[StoredTree], seed: int) -> None:
    """Let the network's energy gain undo what drawing does to the energy."""
    model = SmallModel(network, name="small")
    changes = []
    for tree in trees:
        voxels = voxels_of(tree)
        drawn = model.generate(voxels, wind=tree.wind, seed=seed).coefficients[:, 1:] @ wind_axes(tree.wind).T
        moving = torch.from_numpy(drawn / np.float32(voxels.grid.height_m))
        changes.append((_mean_square(moving) / _mean_square(model.prepare(voxels, tree.wind).amplitude)).log())
    network.energy_gain.mul_((-torch.stack(changes).mean(dim=0) / 2).exp())


def _mean_square(field: Tensor) -> Tensor:
    mean: Tensor = field.abs().square().mean(dim=0)
    return mean
