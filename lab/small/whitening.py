"""Whitening: divide spectra by the predicted amplitude, average on the nodes, and measure the statistics."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.models.small.features import TreeFeatures, coarsen_features, wind_vector
from dynamictree.models.small.mixer import Neighbourhood, neighbourhood
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.stem_noise import StemNoise, stem_noise
from dynamictree.sparse.pool import pool_to
from dynamictree.spectrum import Wind
from lab.small.examples import Example

MEASURED = ("common_share", "log_gain", "spread")
NUM_MEASURED = 24
"""Number of trees for measuring scales and shares."""
HORIZONTAL = slice(0, 2)  # axes; upright, branches on both sides of a crown move in opposite senses


@dataclass(frozen=True, kw_only=True, eq=False)
class WhiteExample:
    """Training example of the denoiser: a tree's whitened spectrum on its nodes."""

    nodes: TreeFeatures
    wind: Wind
    whitened: Complex64[Tensor, "W J 3"]
    log_amplitude: Float32[Tensor, "W J 3"]
    noise: StemNoise
    neighbourhood: Neighbourhood


@torch.no_grad()
def whiten(network: SmallNetwork, example: Example) -> tuple[Complex64[Tensor, "V J 3"], Float32[Tensor, "V J 3"]]:
    """Return c / A at every voxel for k >= 1, and ln A."""
    _, log_amplitude = network.amplitude.of_tree(
        example.tree, network.foliage(example.tree), wind_vector([example.wind])
    )
    return example.spectrum[:, 1:] * (-log_amplitude).exp(), log_amplitude


@torch.no_grad()
def measure(network: SmallNetwork, examples: Iterable[Example]) -> Float32[Tensor, "J 3"]:
    """Set the share of the forces on stems that is common to all: that of the mean in the motion's power.

    Returns:
        Standard deviation of the real or imaginary part of whitened spectra on the nodes, the denoiser's divisor.
    """
    top = network.preset.top
    nodes = [pool_to(whiten(network, one)[0], one.tree.grids, top) for one in examples]
    power = torch.stack([one.abs().square().mean(dim=0) for one in nodes])  # [T, J, 3]
    mean = torch.stack([one.mean(dim=0).abs().square() for one in nodes])
    network.common_share.copy_((mean / power)[..., HORIZONTAL].mean(dim=(0, 2)))
    return (power / 2).sqrt().median(dim=0).values


@torch.no_grad()
def white_example(network: SmallNetwork, example: Example, deviation: Float32[Tensor, "J 3"]) -> WhiteExample:
    """Convert one tree for the denoiser's training; `deviation` is that of `measure`."""
    field, log_amplitude = whiten(network, example)
    leaf = network.foliage(example.tree)[:, 0].clamp(0, 1)
    grids, top, wind = example.tree.grids, network.preset.top, wind_vector([example.wind])
    nodes = coarsen_features(example.tree, top)
    return WhiteExample(
        nodes=nodes,
        wind=example.wind,
        whitened=pool_to(field, grids, top) / deviation,
        log_amplitude=pool_to(log_amplitude, grids, top),
        noise=stem_noise(example.tree, log_amplitude, wind, network.common_share, leaf, top),
        neighbourhood=neighbourhood(nodes),
    )
