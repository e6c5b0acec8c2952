"""Whitening: divide spectra by the predicted amplitude, average on the nodes, and measure the statistics."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Float64
from scipy.optimize import nnls
from torch import Tensor

from dynamictree.models.small.correlated_noise import NoiseBasis, field_matrices, noise_basis
from dynamictree.models.small.features import TreeFeatures, coarsen_features, wind_vector
from dynamictree.models.small.mixer import Neighbourhood, neighbourhood
from dynamictree.models.small.network import SmallNetwork
from dynamictree.sparse.pool import pool_to
from dynamictree.spectrum import Wind
from lab.small.examples import Example

WHITE_SHARE = 0.7
"""Share of white noise beside that fitted to the data, so that smoothness also distinguishes data from noise."""
MEASURED = ("leaf_share", "noise_shares", "log_gain", "spread")
NUM_MEASURED = 24
"""Number of trees for measuring scales and shares."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WhiteExample:
    """Training example of the denoiser: a tree's whitened spectrum on its nodes."""

    nodes: TreeFeatures
    wind: Wind
    whitened: Complex64[Tensor, "W J 3"]
    log_amplitude: Float32[Tensor, "W J 3"]
    noise: NoiseBasis
    neighbourhood: Neighbourhood


@torch.no_grad()
def whiten(network: SmallNetwork, example: Example) -> tuple[Complex64[Tensor, "V J 3"], Float32[Tensor, "V J 3"]]:
    """Return c / A at every voxel for k >= 1, and ln A."""
    _, log_amplitude = network.amplitude.of_tree(
        example.tree, network.foliage(example.tree), wind_vector([example.wind])
    )
    return example.spectrum[:, 1:] * (-log_amplitude).exp(), log_amplitude


@torch.no_grad()
def measure(network: SmallNetwork, examples: Iterable[Example], rng: np.random.Generator) -> Float32[Tensor, "J 3"]:
    """Set the network's noise shares.

    Returns:
        Standard deviation of the real or imaginary part of whitened spectra on the nodes, the denoiser's divisor.
    """
    examples, top = list(examples), network.preset.top
    nodes = [pool_to(whiten(network, one)[0], one.tree.grids, top) for one in examples]
    deviation = torch.stack([(one.abs().square().mean(dim=0) / 2).sqrt() for one in nodes]).median(dim=0).values
    trees, spectra = [coarsen_features(one.tree, top) for one in examples], [(one / deviation).numpy() for one in nodes]
    fitted = torch.from_numpy(fit_shares(spectra, trees, rng)) * (1 - WHITE_SHARE)
    fitted[:, 0] += WHITE_SHARE
    network.noise_shares.copy_(fitted)
    return deviation


@torch.no_grad()
def white_example(network: SmallNetwork, example: Example, deviation: Float32[Tensor, "J 3"]) -> WhiteExample:
    """Convert one tree for the denoiser's training; `deviation` is that of `measure`."""
    field, log_amplitude = whiten(network, example)
    grids, top = example.tree.grids, network.preset.top
    nodes = coarsen_features(example.tree, top)
    return WhiteExample(
        nodes=nodes,
        wind=example.wind,
        whitened=pool_to(field, grids, top) / deviation,
        log_amplitude=pool_to(log_amplitude, grids, top),
        noise=noise_basis(nodes.grids, nodes.links),
        neighbourhood=neighbourhood(nodes),
    )


def fit_shares(
    spectra: list[Complex64[np.ndarray, "_ J C"]], trees: list[TreeFeatures], rng: np.random.Generator
) -> Float64[np.ndarray, "J S"]:
    """Fit the shares of the scales by least squares over pairs of nodes: the data's covariance against each field's."""
    covariances, products = [], []
    for spectrum, nodes in zip(spectra, trees, strict=True):
        first, second = _pairs(nodes, rng)
        fields = field_matrices(nodes.grids, nodes.links)
        overlap = [np.asarray(field[first].multiply(field[second]).sum(axis=1)).ravel() for field in fields]
        covariances.append(np.stack(overlap, axis=1))  # [P, S]
        products.append((spectrum[first] * spectrum[second].conj()).real.mean(axis=2))  # [P, J]
    design, target = np.concatenate(covariances), np.concatenate(products)
    shares = np.stack([nnls(design, target[:, column])[0] for column in range(target.shape[1])])
    normalised: Float64[np.ndarray, "J S"] = shares / shares.sum(axis=1, keepdims=True)
    return normalised


def _pairs(nodes: TreeFeatures, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw pairs of nodes: with themselves, neighbours, ancestors, siblings, and random ones."""
    grids, size = nodes.grids, len(nodes.scalars)
    bearer = np.arange(size)
    bearer[nodes.links[:, 0].numpy()] = nodes.links[:, 1].numpy()
    second_bearer = bearer[bearer]
    fourth_bearer = second_bearer[second_bearer]
    near = [torch.cat([pair[side] for pair in grids.levels[0].pairs]).numpy() for side in (0, 1)]
    chosen = rng.choice(len(near[0]), min(size, len(near[0])), replace=False)
    every = rng.permutation(size)
    kin = np.argsort(grids.parents[0].numpy(), kind="stable")
    grand = np.argsort(grids.parents[1].numpy()[grids.parents[0].numpy()], kind="stable")
    firsts = [every, every, every, every, near[0][chosen], kin[:-4], grand[:-16], rng.integers(0, size, size)]
    seconds = [
        every,
        bearer[every],
        second_bearer[every],
        fourth_bearer[every],
        near[1][chosen],
        kin[4:],
        grand[16:],
        rng.integers(0, size, size),
    ]
    return np.concatenate(firsts), np.concatenate(seconds)
