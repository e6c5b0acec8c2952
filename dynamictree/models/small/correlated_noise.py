"""Noise with the spatial correlation of the motion, so that the network need not learn smoothness.

Each node draws from several fields at once: white at the nodes, smoothed along the stems, raised from coarser levels,
and one number for the whole tree. All have unit variance at every node; their shares are fitted, a frequency, to how
the training set's whitened spectra correlate.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Float64, Int64
from scipy.optimize import nnls
from scipy.sparse import csr_array, eye_array
from torch import Tensor

from dynamictree.models.small.features import TreeFeatures
from dynamictree.sparse.level import Pyramid
from dynamictree.sparse.matrices import (
    SparseRows,
    link_matrices,
    raise_matrix,
    sparse_rows,
    touching,
    unit_rows,
)

STEPS_ALONG = (1, 2, 4, 8)
NUM_SCALES = 2 + len(STEPS_ALONG) + 3
"""White at the nodes; over what touches; along the stems by STEPS_ALONG; from one and two levels up; the whole tree."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseBasis:
    """Noise basis of one tree: matrices [W, n] with rows of unit length."""

    fields: tuple[SparseRows, ...]

    def draw(
        self, shares: Float32[Tensor, "J S"], generator: torch.Generator, *, channels: int
    ) -> Float32[Tensor, "W J C"]:
        """Noise of unit variance; `shares` of the scales' variances for each frequency, sum 1."""
        total: Tensor | None = None
        for field, share in zip(self.fields, shares.T, strict=True):
            white = torch.randn(field.num_columns, len(shares), channels, generator=generator)
            drawn = field.apply(white * share.sqrt()[:, None])
            total = drawn if total is None else total + drawn
        assert total is not None
        return total


def noise_basis(grids: Pyramid, links: Int64[Tensor, "L 2"]) -> NoiseBasis:
    """Build the noise basis of a tree, given at its nodes (see `coarsen_features`)."""
    return NoiseBasis(fields=tuple(sparse_rows(matrix) for matrix in field_matrices(grids, links)))


def field_matrices(grids: Pyramid, links: Int64[Tensor, "L 2"]) -> tuple[csr_array, ...]:
    """[W, n] of each scale, finest first; rows of unit length."""
    size = len(grids.levels[0])
    white = csr_array(eye_array(size, format="csr", dtype=np.float32))
    down, up = link_matrices(links, size)
    step = csr_array((white + down + up) / 3)
    along, walked = [], white
    for count in range(1, max(STEPS_ALONG) + 1):
        walked = csr_array(step @ walked)
        if count in STEPS_ALONG:
            along.append(walked)
    coarser = [raise_matrix(grids, depth, 0) for depth in (1, 2)]
    whole = csr_array(np.ones((size, 1), np.float32))
    return tuple(unit_rows(field) for field in (white, touching(grids.levels[0]), *along, *coarser, whole))


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
