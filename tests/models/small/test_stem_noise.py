"""Noise of stems that rotate, and amplitudes that are smooth along them."""

import numpy as np
import pytest
import torch

from dynamictree.models.small.amplitude import smooth_on_wood
from dynamictree.models.small.features import TreeFeatures
from dynamictree.models.small.stem_noise import StemNoise, stem_noise

BINS = 3
EAST = torch.tensor([[1.5, 0.2, 1.0, 0.0]])


def noise_of(tree: TreeFeatures, shared: float) -> StemNoise:
    log_amplitude = tree.scalars[:, :1, None].expand(-1, BINS, 3) - 5  # higher voxels move further
    return stem_noise(
        tree, log_amplitude.contiguous(), EAST, torch.full((BINS,), shared), torch.zeros(len(tree.scalars)), 2
    )


@pytest.mark.parametrize("shared", [0.0, 0.4, 1.0])
def test_noise_has_unit_variance_where_it_moves(tree: TreeFeatures, shared: float) -> None:
    noise, generator = noise_of(tree, shared), torch.Generator().manual_seed(0)
    power = torch.stack(
        [noise.field(noise.draw(torch.full((BINS,), shared), generator)).square() for _ in range(400)]
    ).mean(dim=0)
    moves = noise.size > 0.1 * noise.size.amax(dim=0)
    np.testing.assert_allclose(power[moves.repeat(1, 1, 2)], 1, atol=0.4)
    assert float(power[moves.repeat(1, 1, 2)].mean()) == pytest.approx(1, abs=0.03)


def test_a_stem_neither_stretches_nor_leaves_its_base(tree: TreeFeatures) -> None:
    noise, stems = noise_of(tree, 0.3), tree.stems
    assert stems is not None
    forces = noise.draw(torch.full((BINS,), 0.3), torch.Generator().manual_seed(0))
    moved = noise.field(forces).unflatten(2, (2, 3)) * noise.size[:, :, None]
    base = stems.base[stems.of_voxel]
    ends = torch.stack([torch.arange(len(base)), base])[:, base != torch.arange(len(base))]
    arm = noise.place[ends[0]] - noise.place[ends[1]]
    growth = ((moved[ends[0]] - moved[ends[1]]) * arm[:, None, None]).sum(dim=3)
    assert float(growth.abs().max()) < 1e-4 * float(moved.abs().max() * arm.norm(dim=1).max())
    assert float(moved[stems.base[stems.is_trunk]].abs().max()) < 1e-6


def test_some_frequencies_are_those_of_the_whole(tree: TreeFeatures) -> None:
    noise, bins = noise_of(tree, 0.3), torch.tensor([0, 2])
    forces = noise.draw(torch.full((BINS,), 0.3), torch.Generator().manual_seed(0))
    torch.testing.assert_close(noise.of_bins(bins).field(forces[:, bins]), noise.field(forces)[:, bins])


def test_amplitudes_are_smooth_along_wood_and_free_on_leaves(tree: TreeFeatures) -> None:
    size, links = len(tree.scalars), tree.links
    wood = (torch.arange(size) % 3 > 0).float()
    values = torch.randn(size, BINS, 3)
    smooth = smooth_on_wood(values, links, wood)
    of_wood = wood[links].prod(dim=1) > 0
    leaves = torch.ones(size, dtype=torch.bool)
    leaves[links[of_wood].flatten()] = False
    torch.testing.assert_close(smooth[leaves], values[leaves])
    steps = [(one[links[of_wood, 0]] - one[links[of_wood, 1]]).square().mean() for one in (smooth, values)]
    assert steps[0] < 0.02 * steps[1]
    torch.testing.assert_close(smooth_on_wood(torch.ones(size, BINS, 3), links, wood), torch.ones(size, BINS, 3))
