"""Additions to the paper's recipe: wind, amplitude, stems, noise along the tree."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from dynamictree.errors import CheckpointError, InputError
from dynamictree.models import load_model
from dynamictree.models.paper.generate import PaperModel
from dynamictree.models.paper.network import (
    ADDITIONS,
    PaperNetwork,
    PaperPreset,
    additions_of,
    paper_small_preset,
    with_additions,
)
from dynamictree.models.paper.unet import UNetShape
from dynamictree.models.small.denoiser import DenoiserShape
from dynamictree.models.small.network import SmallNetwork, SmallPreset
from dynamictree.models.weights_file import write_weights
from dynamictree.spectrum import Wind
from dynamictree.voxel.voxelize import SurfaceVoxels
from lab.dataset.sample import make_sample
from lab.dataset.shards import store, write_shard
from lab.paper.examples import PaperExample, batch_of, paper_example
from lab.paper.loss import batch_noise
from lab.paper.train import PaperTraining, clean_channels, load_regression, train_paper

SMALL = SmallPreset(
    foliage_widths=(8, 8, 8),
    amplitude_width=8,
    amplitude_depth=1,
    denoiser=DenoiserShape(width=8, embedding=8, num_blocks=1),
)
PLAIN = PaperPreset(
    resolution=32,
    encoder_base=8,
    encoder_widths=(8, 8, 8),
    unet=UNetShape(
        base=8,
        num_heads=2,
        num_groups=4,
        embedding=16,
        multipliers=(1, 2, 2),
        attention_levels=(1,),
        num_blocks=1,
        num_skips=2,
    ),
    num_steps=2,
)
PRESET = replace(with_additions(PLAIN, ADDITIONS), regression=SMALL)
WIND = Wind(speed_m_s=5.0, direction_deg=30.0, gust=0.3)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> str:
    torch.manual_seed(0)
    network = SmallNetwork(SMALL)
    network.noise_shares.copy_(torch.rand(15, 9) + 0.1)
    network.noise_shares.div_(network.noise_shares.sum(dim=1, keepdim=True))
    path = tmp_path_factory.mktemp("weights") / "amplitudes.safetensors"
    write_weights(network, path)
    return str(path)


@pytest.fixture(scope="module")
def network(small: str) -> PaperNetwork:
    torch.manual_seed(1)
    network = PaperNetwork(PRESET)
    assert network.regression is not None
    load_regression(network.regression, small)
    for parameter in network.unet.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    return network


@pytest.fixture(scope="module")
def example(network: PaperNetwork) -> PaperExample:
    return paper_example(store(make_sample(1, "sapling"), resolutions=(128,)), PRESET, network.regression)


def test_the_sizes_are_the_regressions_whatever_the_diffusion_gives(
    network: PaperNetwork, voxels: SurfaceVoxels
) -> None:
    model = PaperModel(network, name="tiny")
    first, again, other = (model.generate(voxels, wind=WIND, seed=seed).coefficients for seed in (0, 0, 1))
    assert first.shape == (len(voxels.grid), 16, 3)
    assert (first == again).all()
    np.testing.assert_allclose(first[:, 0], other[:, 0], atol=1e-9)  # the lean is not by chance
    phases = [np.angle(one[:, 1:]) for one in (first, other)]
    assert np.abs(np.exp(1j * phases[0]) - np.exp(1j * phases[1])).mean() > 0.5
    moving = np.abs(first[:, 1:]).mean(axis=2) > 0
    ratio = np.log(np.abs(first[:, 1:]).mean(axis=2)[moving] / np.abs(other[:, 1:]).mean(axis=2)[moving])
    assert np.median(np.abs(ratio)) < 0.35  # `soften` leaves some of the draw


def test_noise_along_a_tree_has_unit_variance_and_neighbours_that_agree(
    network: PaperNetwork, example: PaperExample
) -> None:
    batch = batch_of([example, example], PRESET)
    frequency = torch.arange(1, 16).repeat(2, 1)
    noise = batch_noise(network, batch, frequency, torch.Generator().manual_seed(0))
    assert noise.shape == (2 * len(example.spectrum), 15, 6)
    # the field of the whole tree is one number per tree, frequency and channel: its mean is no 0, its spread is wide
    assert noise.var().item() == pytest.approx(1, abs=0.25)
    across = (noise[:, None] - noise[batch.neighbours]).square().mean().item()
    white = torch.randn(noise.shape, generator=torch.Generator().manual_seed(1))
    assert across < 0.8 * (white[:, None] - white[batch.neighbours]).square().mean().item()


def test_the_winds_frame_turns_positions_and_normals(example: PaperExample) -> None:
    own, paper = (batch_of([example], preset).inputs for preset in (PRESET, replace(PRESET, wind_frame=False)))
    torch.testing.assert_close(own.normals, paper.normals @ example.axes.T)
    torch.testing.assert_close(own.positions.norm(dim=1), paper.positions.norm(dim=1))
    assert (own.positions - paper.positions).abs().max() > 0.1


def test_a_time_shift_turns_phases_alone(network: PaperNetwork, example: PaperExample) -> None:
    batch, frequency = batch_of([example], PRESET), torch.tensor([[1, 4]])
    plain = clean_channels(batch, frequency, network)
    turned = clean_channels(batch, frequency, network, torch.polar(torch.ones(1, 2), torch.tensor([[0.0, np.pi / 2]])))
    torch.testing.assert_close(turned[:, 0], plain[:, 0])
    torch.testing.assert_close(turned[:, 1, :3], -plain[:, 1, 3:], atol=1e-5, rtol=1e-4)


def test_training_leaves_the_regression_as_it_is_and_resumes(small: str, tmp_path: Path) -> None:
    shard = tmp_path / "4dtree-00000.safetensors"
    with shard.open("wb") as stream:
        write_shard([store(make_sample(1, "sapling"), resolutions=(128,))], stream)
    plan = PaperTraining(
        preset=PRESET,
        num_steps=2,
        smoothness_from=1,
        batch_size=2,
        frequencies_per_tree=2,
        regression_from=small,
        time_shifts=True,
        bf16=False,
        figures_every_s=None,
    )
    train_paper(replace(plan, num_steps=1), [str(shard)], tmp_path)
    trained = train_paper(plan, [str(shard)], tmp_path)
    given = load_model(small).network.state_dict()  # type: ignore[attr-defined]
    assert trained.regression is not None
    for name, value in trained.regression.state_dict().items():
        torch.testing.assert_close(value, given[name], rtol=0, atol=0)
    assert trained.describe_stems is not None
    assert trained.unet.head.weight.abs().max() > 0  # zero before the first step
    model = load_model(str(tmp_path / "paper.safetensors"))
    assert isinstance(model, PaperModel)
    assert model.network.preset == PRESET


@pytest.mark.parametrize("count", range(1, 5))
def test_a_preset_names_its_additions(count: int) -> None:
    assert additions_of(with_additions(PLAIN, ADDITIONS[:count])) == ADDITIONS[:count]
    assert additions_of(PLAIN) == ()


def test_additions_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no addition 'leaves'"):
        with_additions(PLAIN, ["leaves"])
    with pytest.raises(InputError, match="need the addition amplitude"):
        with_additions(PLAIN, ["noise"])
    with pytest.raises(InputError, match="the grid is 16"):
        with_additions(replace(PLAIN, resolution=16), ["amplitude"])
    write_weights(PaperNetwork(PLAIN), tmp_path / "paper.safetensors")
    with pytest.raises(CheckpointError, match="dynamictree-paper"):
        load_regression(SmallNetwork(SMALL), str(tmp_path / "paper.safetensors"))


def test_the_shipped_file_is_of_the_preset_that_training_takes() -> None:
    model = load_model("paper-small")
    assert isinstance(model, PaperModel)
    assert model.network.preset == with_additions(paper_small_preset(), ADDITIONS)
