"""What the sparse layers give is what dense layers give at the occupied voxels."""

import pytest
import torch
from torch.nn import functional

from dynamictree.sparse.attention import SampleAttention
from dynamictree.sparse.conv import SubmanifoldConv
from dynamictree.sparse.level import (
    Pyramid,
    SparseLevel,
    batch_levels,
    batch_pyramids,
    pyramid,
    sparse_level,
    turn_pyramid,
)
from dynamictree.sparse.norm import SampleGroupNorm
from dynamictree.sparse.pool import average_pool, max_pool, upsample

RESOLUTION = 8


def random_coords(seed: int, share: float = 0.25) -> torch.Tensor:
    occupied = torch.rand(RESOLUTION, RESOLUTION, RESOLUTION, generator=torch.Generator().manual_seed(seed)) < share
    return occupied.nonzero()


def to_dense(features: torch.Tensor, coords: torch.Tensor) -> torch.Tensor:
    """[V, C] -> [1, C, R, R, R]."""
    dense = features.new_zeros(features.shape[-1], RESOLUTION, RESOLUTION, RESOLUTION)
    dense[:, coords[:, 0], coords[:, 1], coords[:, 2]] = features.T
    return dense[None]


def at(dense: torch.Tensor, coords: torch.Tensor) -> torch.Tensor:
    return dense[0][:, coords[:, 0], coords[:, 1], coords[:, 2]].T


def dense_twin(conv: SubmanifoldConv, features: torch.Tensor, coords: torch.Tensor) -> torch.Tensor:
    cin, cout = conv.weight.shape[1:]
    kernel = conv.weight.permute(2, 1, 0).reshape(cout, cin, 3, 3, 3)
    return at(functional.conv3d(to_dense(features, coords), kernel, conv.bias, padding=1), coords)


@pytest.mark.parametrize("share", [0.02, 0.25, 1.0])
def test_convolution_and_its_gradients_are_the_dense_ones(share: float) -> None:
    torch.manual_seed(0)
    coords = random_coords(1, share)
    level, conv = sparse_level(coords), SubmanifoldConv(5, 7).double()
    features = torch.randn(len(coords), 5, dtype=torch.float64, requires_grad=True)
    weighting = torch.randn(len(coords), 7, dtype=torch.float64)
    gradients = []
    for values in (conv(features, level), dense_twin(conv, features, coords)):
        gradients.append(torch.autograd.grad((values * weighting).sum(), [features, conv.weight, conv.bias]))
        torch.testing.assert_close(values, dense_twin(conv, features, coords))
    for ours, dense in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, dense)


def test_convolution_passes_gradcheck_with_an_inner_axis() -> None:
    coords = random_coords(2, 0.03)
    level, conv = sparse_level(coords), SubmanifoldConv(2, 3).double()
    features = torch.randn(len(coords), 2, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda x, w: torch.func.functional_call(conv, {"weight": w}, (x, level)), (features, conv.weight)
    )


def layers() -> list[torch.nn.Module]:
    attention = SampleAttention(8, num_heads=2, num_groups=4)
    torch.nn.init.normal_(attention.project.weight)
    return [SubmanifoldConv(8, 6), SampleGroupNorm(4, 8), attention]


@pytest.mark.parametrize("index", [0, 1, 2])
def test_an_inner_axis_is_carried_along(index: int) -> None:
    torch.manual_seed(0)
    layer, level = layers()[index], batch_levels([sparse_level(random_coords(seed)) for seed in (3, 4)])
    features = torch.randn(len(level), 3, 8)
    apart = torch.stack([layer(features[:, inner].contiguous(), level) for inner in range(3)], dim=1)
    torch.testing.assert_close(layer(features, level), apart)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_samples_of_a_batch_do_not_see_each_other(index: int) -> None:
    torch.manual_seed(0)
    layer, levels = layers()[index], [sparse_level(random_coords(seed, 0.1 * seed)) for seed in (1, 2, 3)]
    features = [torch.randn(len(level), 8) for level in levels]
    together = layer(torch.cat(features), batch_levels(levels))
    apart = torch.cat([layer(rows, level) for rows, level in zip(features, levels, strict=True)])
    torch.testing.assert_close(together, apart)


def test_group_norm_is_torch_group_norm_with_scale_and_shift() -> None:
    torch.manual_seed(0)
    norm, level = SampleGroupNorm(4, 8), sparse_level(random_coords(6))
    features, scale, shift = torch.randn(len(level), 8) * 3 + 1, torch.randn(1, 8), torch.randn(1, 8)
    oracle = functional.group_norm(features.T[None], 4)[0].T
    torch.testing.assert_close(norm(features, level), oracle, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(norm(features, level, scale, shift), oracle * (1 + scale) + shift, atol=1e-5, rtol=1e-4)


def test_attention_is_softmax_over_all_voxels() -> None:
    torch.manual_seed(0)
    attention = layers()[2]
    level = sparse_level(random_coords(7, 0.1))
    features = torch.randn(len(level), 8)
    queries, keys, values = attention.queries_keys_values(attention.norm(features, level)).chunk(3, dim=1)
    mixed = torch.empty_like(features)
    for head in (slice(0, 4), slice(4, 8)):
        weights = (queries[:, head] @ keys[:, head].T / 4**0.5).softmax(dim=1)
        mixed[:, head] = weights @ values[:, head]
    torch.testing.assert_close(attention(features, level), features + attention.project(mixed))


def children(grids: Pyramid, row: int) -> torch.Tensor:
    return (grids.levels[0].coords // 2 == grids.levels[1].coords[row]).all(dim=1)


def test_pooling_looks_at_the_children_and_upsampling_at_the_parent() -> None:
    grids = pyramid(random_coords(8), 2)
    fine, coarse = grids.levels
    features = torch.randn(len(fine), 2, 3)
    pooled = average_pool(features, grids.parents[0], len(coarse))
    largest = max_pool(features[:, 0], grids.parents[0], len(coarse))
    for row in range(len(coarse)):
        torch.testing.assert_close(pooled[row], features[children(grids, row)].mean(dim=0))
        torch.testing.assert_close(largest[row], features[children(grids, row), 0].amax(dim=0))
    raised = upsample(pooled, grids.parents[0])
    for row in range(len(coarse)):
        assert (raised[children(grids, row)] == pooled[row]).all()


def test_a_batch_of_pyramids_is_each_pyramid() -> None:
    alone = [pyramid(random_coords(seed, 0.05 * seed), 3) for seed in (1, 2, 3)]
    together = batch_pyramids(alone)
    for depth in range(2):
        features = torch.randn(len(together.levels[depth]), 4)
        pooled = average_pool(features, together.parents[depth], len(together.levels[depth + 1]))
        parts = [
            average_pool(features[rows], one.parents[depth], len(one.levels[depth + 1]))
            for one, rows in zip(alone, together.levels[depth].sample_slices, strict=True)
        ]
        torch.testing.assert_close(pooled, torch.cat(parts))
        assert together.levels[depth].sample_of_row.bincount().tolist() == list(together.levels[depth].sizes)


def pair_set(level: SparseLevel) -> set[tuple[int, int, int]]:
    return {
        (tap, a, b)
        for tap, pair in enumerate(level.pairs)
        for a, b in zip(pair[0].tolist(), pair[1].tolist(), strict=True)
    }


@pytest.mark.parametrize(
    ("axes", "signs"), [((1, 0, 2), (-1, 1, 1)), ((0, 1, 2), (-1, 1, 1)), ((2, 0, 1), (1, -1, -1))]
)
def test_a_turned_pyramid_is_the_pyramid_of_turned_voxels(
    axes: tuple[int, int, int], signs: tuple[int, int, int]
) -> None:
    turned = turn_pyramid(pyramid(random_coords(9), 2), axes, signs)
    for level in turned.levels:
        assert pair_set(level) == pair_set(sparse_level(level.coords))
