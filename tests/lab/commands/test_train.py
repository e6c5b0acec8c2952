"""`train` from end to end, with networks small enough for a test."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from typer import Typer
from typer.testing import CliRunner

from dynamictree.errors import InputError
from dynamictree.models import load_model
from dynamictree.models.small.denoiser import DenoiserShape
from dynamictree.models.small.network import SmallNetwork
from dynamictree.weights import weights_path
from lab.commands.train import train
from lab.dataset.sample import make_sample
from lab.dataset.shards import stored_tree, write_shard
from lab.evaluation.baselines import fit_by_height, training_tree
from lab.evaluation.held_out_trees import iter_held_out
from lab.small.examples import Example, iter_training, make_example
from lab.small.training_steps import VOXELS_PER_TREE, amplitude_rows, read_rows, write_rows
from lab.small.whitening import MEASURED
from tests.formats.meshes import written

SEED = 1005
TRAINING = (Path(__file__).parents[3] / "docs" / "training.md").read_text()


@pytest.fixture(scope="module")
def commands() -> Typer:
    app = Typer(pretty_exceptions_enable=False)
    app.command()(train)
    app.callback()(lambda: None)  # so that the command keeps its name
    return app


@pytest.fixture(scope="module")
def example() -> Example:
    return make_example(SEED)


@pytest.fixture(scope="module")
def shards(tmp_path_factory) -> Path:
    """A folder with one shard: three trees for training, one for validation between them, one of a species held out."""
    folder = tmp_path_factory.mktemp("shards")
    own = [(1, "sapling"), (20, "sapling"), (2, "sapling"), (4, "palm"), (3, "sapling")]
    trees = [stored_tree(make_sample(*one), resolutions=(128,)) for one in own]
    (folder / "4dtree-00000.safetensors").write_bytes(written(write_shard, trees))
    return folder


def test_a_dry_run_prints_the_resolved_run_and_does_nothing(commands: Typer, tmp_path) -> None:
    arguments = ["train", str(tmp_path / "run"), "--dataset", str(tmp_path), "--dry-run", "--json"]
    plan = json.loads(CliRunner().invoke(commands, [*arguments, "--denoiser-steps", "7"]).stdout)
    assert plan["denoiser"]["schedule"]["num_steps"] == 7
    assert plan["preset"]["denoiser"]["width"] == DenoiserShape().width
    paper = json.loads(CliRunner().invoke(commands, [*arguments, "--preset", "paper", "--micro-trees", "4"]).stdout)
    assert (paper["num_steps"], paper["smoothness_from"]) == (70_000, 40_000)
    assert (paper["batch_size"], paper["micro_trees"]) == (48, 4)
    assert paper["preset"]["encoder_widths"] == [32, 64, 128]
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--preset", "huge"], "'huge'"),
        (["--foliage-steps", "0"], "0 steps keep a network"),
        (["--denoiser-steps", "0"], "0 steps keep a network"),
        (["--foliage-trees", "0", "--start-from", "x"], "has steps and no trees"),
    ],
)
def test_what_cannot_be_trained_is_refused(commands: Typer, tmp_path, arguments: list[str], message: str) -> None:
    result = CliRunner().invoke(commands, ["train", str(tmp_path), "--dataset", str(tmp_path), *arguments])
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)


def test_a_folder_without_shards_is_refused_and_too_few_trees_are(commands: Typer, shards: Path, tmp_path) -> None:
    empty = CliRunner().invoke(commands, ["train", str(tmp_path / "run"), "--dataset", str(tmp_path)])
    assert "no shards" in str(empty.exception)
    paths = [str(path) for path in shards.iterdir()]
    assert [tree.seed for tree in iter_training(paths, first=1, count=2)] == [2, 3]
    with pytest.raises(InputError, match="hold 3 trees for training; 5 are needed"):
        list(iter_training(paths, first=1, count=4))


def test_shards_of_several_folders_come_in_turn(commands: Typer, shards: Path, tmp_path, monkeypatch) -> None:
    for number in (0, 1):
        (tmp_path / f"4dtree-{number:05d}.safetensors").write_bytes((shards / "4dtree-00000.safetensors").read_bytes())
    order: list[str] = []
    monkeypatch.setattr("lab.small.train.train_small", lambda plan, paths, *_, **__: order.extend(paths))
    folders = [word for folder in (shards, tmp_path) for word in ("--dataset", str(folder))]
    CliRunner().invoke(commands, ["train", str(tmp_path / "run"), *folders, "--json"], catch_exceptions=False)
    assert [Path(path).parent for path in order] == [shards, tmp_path, tmp_path]
    assert [Path(path).name[-17:-12] for path in order] == ["00000", "00000", "00001"]


@pytest.mark.slow
def test_training_ends_in_weights_that_load_and_goes_on_where_it_was(commands: Typer, shards: Path, tmp_path) -> None:
    trees = [word for part in ("foliage", "amplitude", "denoiser") for word in (f"--{part}-trees", "1")]
    steps = ["--foliage-steps", "2", "--amplitude-steps", "2"]
    arguments = ["train", str(tmp_path), "--dataset", str(shards), *trees, *steps, "--json"]
    result = CliRunner().invoke(commands, [*arguments, "--denoiser-steps", "1"], catch_exceptions=False)
    weights = Path(json.loads(result.stdout)["weights"])
    first = small_network(weights)
    assert [path.name for path in (tmp_path / "rows").iterdir()] == ["000000.safetensors"]
    assert all(f"`{path.name}`" in TRAINING for path in tmp_path.iterdir())
    result = CliRunner().invoke(commands, [*arguments, "--denoiser-steps", "2"], catch_exceptions=False)
    second = small_network(weights)
    for part in ("foliage", "amplitude"):
        for name, value in getattr(first, part).state_dict().items():
            assert (getattr(second, part).state_dict()[name] == value).all()
    assert changed(first.denoiser, second.denoiser)
    other = [*arguments[:1], str(tmp_path / "other"), *arguments[2:], "--denoiser-steps", "1"]
    CliRunner().invoke(commands, [*other, "--start-from", str(weights)], catch_exceptions=False)
    third = small_network(tmp_path / "other" / "small.safetensors")
    assert changed(second.denoiser, third.denoiser)
    assert (second.denoiser.embed_frequency.weight - third.denoiser.embed_frequency.weight).abs().max() < 0.01


@pytest.mark.slow
def test_parts_without_steps_stay_and_the_others_go_on(commands: Typer, shards: Path, tmp_path) -> None:
    shipped = weights_path("small")
    arguments = ["train", str(tmp_path), "--dataset", str(shards), "--foliage-trees", "0", "--amplitude-trees", "1"]
    arguments += f"--foliage-steps 0 --denoiser-steps 0 --amplitude-steps 1 --start-from {shipped} --json".split()
    result = CliRunner().invoke(commands, arguments, catch_exceptions=False)
    ours, trained = small_network(shipped), small_network(Path(json.loads(result.stdout)["weights"]))
    for part in ("foliage", "denoiser"):
        for name, value in getattr(ours, part).state_dict().items():
            assert (getattr(trained, part).state_dict()[name] == value).all(), name
    assert changed(ours.amplitude, trained.amplitude)
    torch.testing.assert_close(trained.amplitude.mean, ours.amplitude.mean)
    torch.testing.assert_close(trained.amplitude.sizes.weight, ours.amplitude.sizes.weight, atol=0.01, rtol=0)
    for name in MEASURED:
        assert (trained.get_buffer(name) == ours.get_buffer(name)).all(), name


def small_network(weights: Path) -> SmallNetwork:
    return load_model(str(weights)).network


def changed(one: torch.nn.Module, other: torch.nn.Module) -> bool:
    return any(not torch.equal(a, b) for a, b in zip(one.parameters(), other.parameters(), strict=True))


def test_rows_round_trip_to_half_precision(tiny_network: SmallNetwork, example: Example, tmp_path) -> None:
    rows = amplitude_rows(tiny_network.foliage, [example], np.random.default_rng(0))
    for number in (0, 1):
        write_rows(rows, tmp_path / f"{number}.safetensors")
    again = read_rows([tmp_path / "0.safetensors", tmp_path / "1.safetensors"])
    assert len(rows) == VOXELS_PER_TREE
    assert len(again) == 2 * len(rows)
    assert (again.inputs[len(rows) :] == rows.inputs).all()
    chosen = np.random.default_rng(0).integers(0, len(example.spectrum), VOXELS_PER_TREE)
    spectrum = example.spectrum[torch.from_numpy(chosen)]
    error = (again.spectrum(torch.arange(len(rows))) - spectrum).abs().square().sum() / spectrum.abs().square().sum()
    assert error < 1e-6


def test_the_baseline_is_what_it_says(example: Example) -> None:
    tree = next(iter_held_out("seen-species", 1))
    own = training_tree(SEED)
    np.testing.assert_allclose(own.spectrum, example.spectrum.numpy(), atol=1e-7)
    by_height = fit_by_height([own])
    rng = np.random.default_rng(0)
    mean = by_height.spectrum(tree.voxels.grid, tree.wind, rng)
    level = tree.voxels.grid.coords[:, 2] == 60
    assert np.ptp(np.abs(mean[level, 1:]), axis=0).max() < 1e-6  # one spectrum a height
