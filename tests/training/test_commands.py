"""`train` from end to end, with networks small enough for a test."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from typer import Typer
from typer.testing import CliRunner

from dynamictree.diffusion.denoiser import DenoiserShape
from dynamictree.diffusion.model import TreeMotionModel, load_model
from dynamictree.diffusion.small import SmallNetwork, SmallPreset
from dynamictree.errors import InputError
from dynamictree.training.baselines import fit_by_height, nearest_tree, noise_only, regression
from dynamictree.training.commands import train
from dynamictree.training.examples import Example, cached_example, is_training_seed, make_example
from dynamictree.training.trees import iter_judged

SEED = 1005


@pytest.fixture(scope="module")
def commands() -> Typer:
    app = Typer(pretty_exceptions_enable=False)
    app.command()(train)
    return app


@pytest.fixture(scope="module")
def example() -> Example:
    return make_example(SEED)


@pytest.fixture(scope="module")
def tiny() -> SmallNetwork:
    torch.manual_seed(0)
    return SmallNetwork(
        SmallPreset(amplitude_width=8, amplitude_depth=1, denoiser=DenoiserShape(width=8, embedding=8, num_blocks=1))
    )


def test_a_dry_run_prints_the_resolved_run_and_does_nothing(commands: Typer, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        commands, ["train", str(tmp_path / "run"), "--denoiser-steps", "7", "--dry-run", "--json"]
    )
    plan = json.loads(result.stdout)
    assert plan["denoiser"]["num_steps"] == 7
    assert plan["preset"]["denoiser"]["width"] == DenoiserShape().width
    assert not (tmp_path / "run").exists()


def test_an_unknown_preset_is_refused(commands: Typer, tmp_path: Path) -> None:
    result = CliRunner().invoke(commands, ["train", str(tmp_path), "--preset", "huge"])
    assert isinstance(result.exception, InputError)
    assert "'huge'" in str(result.exception)


@pytest.mark.slow
def test_training_ends_in_weights_that_load_and_goes_on_where_it_was(commands: Typer, tmp_path: Path) -> None:
    seeds = "8"
    arguments = ["train", str(tmp_path), "--seeds", seeds, "--amplitude-steps", "2", "--json"]
    result = CliRunner().invoke(commands, [*arguments, "--denoiser-steps", "1"], catch_exceptions=False)
    weights = Path(json.loads(result.stdout)["weights"])
    first = load_model(str(weights)).network
    trees = sorted(path.name for path in (tmp_path / "trees").iterdir())
    assert len(trees) == sum(is_training_seed(seed) for seed in range(1000, 1008))
    result = CliRunner().invoke(commands, [*arguments, "--denoiser-steps", "2"], catch_exceptions=False)
    second = load_model(str(weights)).network
    for name, value in first.amplitude.state_dict().items():
        assert (second.amplitude.state_dict()[name] == value).all()
    changed = [
        not torch.equal(a, b) for a, b in zip(first.denoiser.parameters(), second.denoiser.parameters(), strict=True)
    ]
    assert any(changed)


def test_a_cached_example_is_the_example_to_half_precision(example: Example, tmp_path: Path) -> None:
    stored = cached_example(tmp_path, SEED)
    again = cached_example(tmp_path, SEED)
    assert (stored.spectrum == again.spectrum).all()
    error = (stored.spectrum - example.spectrum).abs().square().sum() / example.spectrum.abs().square().sum()
    assert error < 1e-6
    assert (stored.tree.links == example.tree.links).all()
    torch.testing.assert_close(stored.tree.scalars, example.tree.scalars, atol=5e-3, rtol=1e-3)


def test_training_seeds_are_the_datasets_own_split(example: Example) -> None:
    from dynamictree.dataset.sample import make_sample

    seeds = range(1000, 1012)
    assert [is_training_seed(seed) for seed in seeds] == [make_sample(seed).split == "train" for seed in seeds]


def test_baselines_are_what_they_say(example: Example, tiny: SmallNetwork) -> None:
    tree = next(iter_judged("seen-species", 1))
    by_height = fit_by_height([example])
    rng = np.random.default_rng(0)
    mean = by_height.spectrum(tree.voxels.grid, tree.wind, rng)
    level = tree.voxels.grid.coords[:, 2] == 60
    assert np.ptp(np.abs(mean[level, 1:]), axis=0).max() < 1e-6  # one spectrum a height
    copied = nearest_tree(tree.voxels, tree.wind, [example])
    assert len(np.unique(np.abs(copied[:, 1, 2]))) <= len(example.spectrum)
    model = TreeMotionModel(tiny, name="tiny")
    alone = regression(model, tree.voxels, tree.wind, rng)
    angles = np.angle(alone[:, 3, 2])
    assert np.abs(np.exp(1j * (angles - angles[0])) - 1).max() < 1e-3  # one phase a frequency
    noise = noise_only(model, tree.voxels, tree.wind, 0)
    assert np.abs(noise_only(model, tree.voxels, tree.wind, 1) - noise).max() > 0
