"""What is measured between the trainings gives the motion what its regression lacks."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dynamictree.models.small.generate import SmallModel
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.spread import at_speed
from dynamictree.rig.rig import rig_of
from lab.dataset.sample import make_sample
from lab.dataset.shards import StoredTree, stored_tree
from lab.small.examples import Example, example_of, gust_pair, voxels_of
from lab.small.spread import measure_field, measure_spread
from lab.small.whitening import measure, whiten


@pytest.fixture(scope="module")
def stored() -> StoredTree:
    return stored_tree(make_sample(1), resolutions=(128,))


@pytest.fixture(scope="module")
def example(stored: StoredTree) -> Example:
    return example_of(stored)


def test_what_is_drawn_has_the_energy_that_trees_have(tiny_network: SmallNetwork, stored: StoredTree) -> None:
    network = tiny_network
    measure_spread(network, [gust_pair(stored)] * 4)
    measure_field(network, [stored], seed=0)
    model, voxels = SmallModel(network, name="tiny"), voxels_of(stored)
    drawn = model.generate(voxels, wind=stored.wind, seed=5)
    rigs = [rig_of(stored.mesh(), spectrum) for spectrum in (drawn, stored.spectrum())]
    energy, true = (np.log((np.abs(rig.loop(voxels.grid.centres_m, rig.voxels)[:, 7:]) ** 2).sum()) for rig in rigs)
    assert energy == pytest.approx(true, abs=0.2)


@pytest.mark.parametrize("spread", [0.3, 1.0, 1.6])
def test_a_crown_that_a_lull_stills_as_a_whole_is_no_spread(
    tiny_network: SmallNetwork, example: Example, spread: float
) -> None:
    network, generator, pair = tiny_network, torch.Generator().manual_seed(0), []
    for lull in (1.0, 0.1):
        normal = torch.randn(*example.spectrum.shape, dtype=torch.complex64, generator=generator)
        pair.append(replace(example, spectrum=lull * normal * normal.abs() ** (spread - 1)))
    measure_spread(network, [(pair[0], pair[1])] * 4)
    np.testing.assert_allclose(at_speed(network.spread, torch.tensor(example.wind.speed_m_s).log()), spread, rtol=0.15)


def test_each_speed_has_its_own_gain(tiny_network: SmallNetwork, example: Example) -> None:
    gains = []
    calm, storm = (replace(example, wind=replace(example.wind, speed_m_s=speed)) for speed in (1.0, 25.0))
    for fast in (storm, replace(storm, spectrum=3 * storm.spectrum)):
        measure_spread(tiny_network, [(calm, calm), (fast, fast)])
        gains.append(tiny_network.log_gain[[0, -1]].mean(dim=(1, 2)))
    np.testing.assert_allclose(gains[1] - gains[0], [0, np.log(3)], atol=0.05)


def test_the_common_share_is_that_of_the_crowns_mean(tiny_network: SmallNetwork, example: Example) -> None:
    generator, shape = torch.Generator().manual_seed(0), example.spectrum.shape
    own = torch.randn(*shape, dtype=torch.complex64, generator=generator)
    network, (_, log_amplitude) = tiny_network, whiten(tiny_network, example)
    sizes = torch.cat([torch.ones_like(log_amplitude[:, :1]), log_amplitude.exp()], dim=1)
    for whole, share in ((torch.zeros(1, *shape[1:]), 0.0), (10 * own[:1], 1.0)):
        measure(network, [replace(example, spectrum=(own + whole) * sizes)])
        np.testing.assert_allclose(network.common_share, share, atol=0.1)
