"""What the dataset knows of a tree's parts, and that the foliage network learns it from all sides."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dynamictree.models.small.features import NUM_WIND, wind_vector
from dynamictree.models.small.foliage import ARM, NUM_FOLIAGE_VALUES, NUM_PARTS, FoliageNetwork
from dynamictree.requests import Wind
from lab.dataset.sample import make_sample
from lab.dataset.sapling import LEAF
from lab.dataset.shards import StoredTree, stored_tree
from lab.small.examples import example_of
from lab.small.train_foliage import (
    ARM_SCALE,
    BLIND_EVERY,
    FoliageExample,
    foliage_examples,
    foliage_step,
    standardise_foliage,
    true_parts,
)
from lab.small.training_steps import TREE_SHARE, amplitude_losses
from lab.training.trainer import LearningRateSchedule, Trainer, TrainerOptions

SEED = 9


@pytest.fixture(scope="module")
def stored() -> StoredTree:
    return stored_tree(make_sample(SEED, "sapling"), resolutions=(32, 128))


@pytest.fixture(scope="module")
def example(stored: StoredTree) -> FoliageExample:
    (example,) = foliage_examples([stored], resolution=32)
    return example


def test_parts_tell_leaf_from_wood_and_how_far_out(stored: StoredTree) -> None:
    parts = true_parts(stored, stored.voxels(128).grid)
    leaf = parts[:, 0]
    assert parts.shape[1] == NUM_PARTS
    assert 0 <= leaf.min() < 1e-6
    assert leaf.max() == pytest.approx(1, abs=1e-5)
    wood = leaf < 1e-6
    assert np.abs(parts[wood][:, [1, 2, 3, 7, 8, 9]]).max() < 1e-5
    # the vector from the base is as long as the distance from it, but where several leaves share a voxel
    outer = (leaf > 0.999) & (parts[:, 2] > 0.8)
    ratio = np.linalg.norm(parts[outer][:, ARM], axis=1) / parts[outer, 1]
    assert ratio.max() < 1.001
    assert np.percentile(ratio, 5) > 0.95
    height = np.ptp(stored.tensors["vertices"][:, 2])
    cards = stored.tensors["vertices"][stored.tensors["part"] == LEAF].reshape(-1, 4, 3)
    longest = np.linalg.norm(cards[:, 2] - cards[:, 0], axis=1).max()
    assert parts[:, 1].max() <= 1.01 * longest * ARM_SCALE / height


def test_some_trees_are_seen_as_voxels_alone(stored: StoredTree) -> None:
    seeds = (BLIND_EVERY, BLIND_EVERY + 1)
    blind, seeing = foliage_examples([replace(stored, seed=seed) for seed in seeds], resolution=32)
    assert (blind.tree().surface[:, -1] == 0).all()
    assert (seeing.tree().surface[:, -1] == 1).all()
    assert (blind.targets == seeing.targets).all()


def test_the_foliage_network_learns_a_tree(example: FoliageExample) -> None:
    torch.manual_seed(0)
    network = FoliageNetwork(widths=(8, 8, 8))
    standardise_foliage(network, [example])
    trainer = Trainer(
        network, TrainerOptions(schedule=LearningRateSchedule(num_steps=25, learning_rate=1e-2, warmup_steps=3))
    )
    losses = [loss for _, loss in trainer.run(lambda rng: foliage_step(network, [example], rng))]
    assert np.mean(losses[-3:]) < 0.7 * np.mean(losses[:3])
    predicted = network(example.tree())
    assert predicted.shape == (len(example.targets), NUM_FOLIAGE_VALUES)
    # means and deviations undo themselves: the prediction has the units of the targets
    error = (predicted - example.targets.float())[:, NUM_PARTS:].square().mean()
    assert error < example.targets.float()[:, NUM_PARTS:].var(dim=0).mean()


def test_the_truth_has_no_amplitude_error_but_its_axes_scatter() -> None:
    stored = stored_tree(make_sample(SEED, "sapling", wind=Wind(speed_m_s=15.0)), resolutions=(32, 128))
    spectrum = example_of(stored).spectrum
    spectrum = spectrum[spectrum.abs().amin(dim=(1, 2)) > 1e-4]  # far above the floor
    assert len(spectrum) > 100
    wind = wind_vector([stored.wind])[:, :NUM_WIND].expand(len(spectrum), NUM_WIND)
    size = spectrum[:, 1:].abs().clamp_min(1e-7).log()
    losses = amplitude_losses(spectrum[:, 0].real, size, spectrum, wind)
    assert losses.lean == 0
    assert max(losses.overall, losses.centroid) < 1e-3
    shifted = amplitude_losses(spectrum[:, 0].real, size + torch.linspace(0, 1, 15)[:, None], spectrum, wind)
    assert shifted.centroid > 100 * losses.centroid
    assert shifted.total() > losses.total()
    pair = torch.cat([spectrum, spectrum])
    stronger = amplitude_losses(pair[:, 0].real, torch.cat([size, size + 0.5]), pair, torch.cat([wind, wind]), 2)
    assert stronger.logarithmic == pytest.approx(0.5**2 / 2 * TREE_SHARE, rel=1e-3)  # little: that is the gusts' chance
