"""Whitening: divide spectra by the predicted amplitude, average on the nodes, and measure the statistics."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Float64
from scipy.optimize import nnls
from scipy.sparse import csr_array
from torch import Tensor

from dynamictree.models.small.correlated_noise import NoiseBasis, field_matrices, leaf_noise, noise_basis
from dynamictree.models.small.features import TreeFeatures, coarsen_features, wind_vector
from dynamictree.models.small.leaf_swing import bases_of
from dynamictree.models.small.mixer import Neighbourhood, neighbourhood
from dynamictree.models.small.network import SmallNetwork
from dynamictree.sparse.level import Pair
from dynamictree.sparse.matrices import raise_matrix, sparse_rows
from dynamictree.sparse.pool import pool_to
from dynamictree.spectrum import Wind
from lab.small.examples import Example

WHITE_SHARE = 0.7
"""Of the noise: white beside what is fitted to the data, so that smoothness distinguishes data from noise too."""
RESIDUAL_SHARE = 0.1
"""Of the variance below the nodes: all of it makes touching voxels differ 1.8 to 2.1 times as much as they do."""
MEASURED = ("node_scale", "residual_share", "noise_shares", "log_gain", "spread")
NUM_MEASURED = 24
"""Trees that scales and shares are measured on."""


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
    """C / A at every voxel for k >= 1, and ln A."""
    _, log_amplitude = network.amplitude.of_tree(
        example.tree, network.foliage(example.tree), wind_vector([example.wind])
    )
    return example.spectrum[:, 1:] * (-log_amplitude).exp(), log_amplitude


@torch.no_grad()
def measure(network: SmallNetwork, examples: Iterable[Example], rng: np.random.Generator) -> Float32[Tensor, "J 3"]:
    """Set the network's node scale, residual share and noise shares; medians over trees.

    Returns:
        Deviation of whitened spectra on the nodes, real and imaginary part each: what the denoiser's are divided by.
    """
    top = network.preset.top
    nodes, trees, deviations, shares = [], [], [], []
    for example in examples:
        field, _ = whiten(network, example)
        grids = example.tree.grids
        pooled = pool_to(field, grids, top)
        lift = sparse_rows(raise_matrix(grids, top, 0))
        lifted = torch.view_as_complex(lift.apply(torch.view_as_real(pooled)))
        bases = bases_of(grids.levels[0].coords.numpy(), network.foliage(example.tree))
        residual = _variance_left(field - lifted, grids.levels[0].pairs, leaf_noise(grids, bases, top))
        whole = _power(lifted) + residual
        shares.append(torch.stack([_power(pooled) / 2, residual]) / whole)
        deviations.append((_power(pooled) / 2).sqrt())
        nodes.append(pooled)
        trees.append(coarsen_features(example.tree, top))
    node_power, residual_share = torch.stack(shares).median(dim=0).values
    network.node_scale.copy_(node_power.sqrt())
    network.residual_share.copy_(RESIDUAL_SHARE * residual_share)
    deviation = torch.stack(deviations).median(dim=0).values
    fitted = torch.from_numpy(fit_shares([(one / deviation).numpy() for one in nodes], trees, rng)) * (1 - WHITE_SHARE)
    fitted[:, 0] += WHITE_SHARE
    network.noise_shares.copy_(fitted)
    return deviation


def _power(field: Complex64[Tensor, "V J 3"]) -> Float32[Tensor, "J 3"]:
    mean: Tensor = field.abs().square().mean(dim=0)
    return mean


def _variance_left(
    residual: Complex64[Tensor, "V J 3"], pairs: Sequence[Pair], noise: csr_array
) -> Float32[Tensor, "J 3"]:
    """Variance of the noise that differs between touching voxels as much as what the nodes do not hold."""
    first, second = (torch.cat([pair[side] for pair in pairs]) for side in (0, 1))
    alike = noise[first.numpy()].multiply(noise[second.numpy()]).sum(axis=1).mean()
    return _power(residual[first] - residual[second]) / (2 - 2 * float(alike))


@torch.no_grad()
def white_example(network: SmallNetwork, example: Example, deviation: Float32[Tensor, "J 3"]) -> WhiteExample:
    """One tree for the denoiser's training; `deviation` as `measure` gives it."""
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
    """Shares of the scales, by least squares over pairs of nodes: the data's covariance against each field's."""
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
    """Pairs of nodes: with themselves, neighbours, ancestors, siblings, and random ones."""
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
