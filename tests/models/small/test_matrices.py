"""Sparse operators, and the layer that mixes scales."""

import numpy as np
import torch
from scipy.sparse import csr_array

from dynamictree.models.small.features import TreeFeatures, coarsen_features, turn_features
from dynamictree.models.small.mixer import MixerBlock, batch_neighbourhoods, neighbourhood
from dynamictree.sparse.matrices import pool_matrix, sparse_rows, upsample_matrix
from dynamictree.sparse.pool import pool_to, upsample


def test_sparse_rows_and_their_gradient_are_the_matrix() -> None:
    dense = torch.rand(7, 5) * (torch.rand(7, 5) < 0.5)
    values = torch.randn(5, 2, 3, requires_grad=True)
    product = sparse_rows(csr_array(dense.numpy())).apply(values)
    torch.testing.assert_close(product, torch.einsum("vw,wij->vij", dense, values))
    weighting = torch.randn_like(product)
    (gradient,) = torch.autograd.grad((product * weighting).sum(), values)
    torch.testing.assert_close(gradient, torch.einsum("vw,vij->wij", dense, weighting))


def test_pool_matrix_is_pooling_and_raising_keeps_constants(tree: TreeFeatures) -> None:
    values = torch.randn(len(tree.scalars), 3)
    pooled = pool_matrix(tree.grids, 1, 0) @ values.numpy()
    torch.testing.assert_close(torch.from_numpy(pooled), pool_to(values, tree.grids, 1))
    raised = upsample_matrix(tree.grids, 2, 0)
    np.testing.assert_allclose(raised @ np.ones(raised.shape[1]), 1, rtol=1e-5)
    nearest = upsample_matrix(tree.grids, 1, 0, steps=0) @ pooled
    torch.testing.assert_close(torch.from_numpy(nearest), upsample(torch.from_numpy(pooled), tree.grids.parents[0]))


def test_a_layer_does_not_look_from_tree_to_tree(tree: TreeFeatures) -> None:
    torch.manual_seed(0)
    layer = MixerBlock(8, 6)
    torch.nn.init.normal_(layer.out.weight)
    nodes = [coarsen_features(tree, 2), coarsen_features(turn_features(tree, (1, 0, 2), (1, 1, 1)), 1)]
    around = [neighbourhood(one) for one in nodes]
    features = [torch.randn(len(one.scalars), 3, 8) for one in nodes]
    embedding = torch.randn(2, 3, 6)
    tree_of_node = torch.repeat_interleave(torch.tensor([0, 1]), torch.tensor([len(one) for one in features]))
    together = layer(torch.cat(features), batch_neighbourhoods(around), embedding, tree_of_node)
    apart = [
        layer(rows, near, embedding[tree : tree + 1], torch.zeros(len(rows), dtype=torch.int64))
        for tree, (rows, near) in enumerate(zip(features, around, strict=True))
    ]
    torch.testing.assert_close(together, torch.cat(apart))
