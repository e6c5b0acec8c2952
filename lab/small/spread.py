"""Measure the spread of motions around the networks' predictions, on trees outside their training data."""

import math
from collections.abc import Iterable

import numpy as np
import torch

from dynamictree.models.small.amplitude import floor_of
from dynamictree.models.small.features import NUM_WIND, wind_vector
from dynamictree.models.small.generate import SmallModel
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.spread import speed_weights
from dynamictree.models.wind import wind_axes
from dynamictree.rig.rig import rig_of
from lab.dataset.shards import StoredTree
from lab.small.examples import Example, voxels_of


@torch.no_grad()
def measure_spread(network: SmallNetwork, pairs: Iterable[tuple[Example, Example]]) -> None:
    """Set the network's spread, and the gain that corrects a typical tree's energy, as functions of the wind speed.

    A pair is one tree in two gusts of one mean wind. The spread is the difference of its sizes where motion is
    expected, without that of the whole crown, since the wind determines the size of a sampled motion.
    """
    log_speeds, scatters, ratios = [], [], []
    for pair in pairs:
        tree, wind = pair[0].tree, wind_vector([pair[0].wind])
        _, log_amplitude = network.amplitude.of_tree(tree, network.foliage(tree), wind)
        floor = floor_of(wind[:, :NUM_WIND])[:, None, None].square()
        power = torch.stack([one.spectrum[:, 1:].abs().square() + floor for one in pair])  # [2, V, J, 3]
        log_speeds.append(wind[0, 0])
        expected = (2 * log_amplitude).exp()
        ratios.append((power.sum(dim=1) / expected.sum(dim=0)).log().mean(dim=0))
        weight, apart = expected / expected.sum(dim=0), power[0].log() - power[1].log()
        scatters.append((weight * (apart - (weight * apart).sum(dim=0)).square()).sum(dim=0) / 2)
    fit = torch.linalg.pinv(speed_weights(torch.stack(log_speeds)))
    variance = torch.einsum("ut,tjx->ujx", fit, torch.stack(scatters)).clamp_min(0)
    network.spread.copy_(variance.mul(6).sqrt() / math.pi)  # variance of ln p: π² / 6 of a complex normal number
    network.log_gain.copy_(torch.einsum("ut,tjx->ujx", fit, torch.stack(ratios)) / 2)


@torch.no_grad()
def measure_field(network: SmallNetwork, trees: Iterable[StoredTree], seed: int) -> None:
    """Correct the network's gain for the energy changed by sampling, and for the bones' extra loss over the truth's."""
    model = SmallModel(network, name="small")
    changes = []
    for tree in trees:
        voxels, true, axes = voxels_of(tree), tree.spectrum(), wind_axes(tree.wind).T
        drawn = model.generate(voxels, wind=tree.wind, seed=seed)
        rigs = (rig_of(tree.mesh(), one) for one in (drawn, true))
        motions = [*(rig.loop(voxels.grid.centres_m, rig.voxels) for rig in rigs), true.coefficients]
        of_drawn, of_true, there = (np.linalg.norm(motion[:, 1:] @ axes, axis=0) for motion in motions)
        expected = torch.linalg.vector_norm(model.prepare(voxels, tree.wind).amplitude, dim=0).numpy()
        changes.append(np.log(of_drawn / of_true * there / expected / np.float32(voxels.grid.height_m)))
    network.log_gain.sub_(torch.from_numpy(np.mean(changes, axis=0)))
