"""The paper's preset from shards: grids that fit, losses that go on where they were, processes that agree."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from dynamictree.errors import InputError
from dynamictree.models import load_model
from dynamictree.models.paper.network import PaperNetwork, paper_preset
from dynamictree.models.weights_file import read_weights
from dynamictree.models.wind import wind_axes, wind_sizes
from lab.dataset.sample import make_sample
from lab.dataset.shards import StoredTree, shards_sha256, stored_tree, write_shard
from lab.paper.examples import ExampleCache, paper_example
from lab.paper.train import PaperTraining, frequency_sizes, train_paper
from tests.formats.meshes import written

SEEDS = (1, 2)
RUN = PaperTraining(
    preset=paper_preset(8, 8), num_steps=3, smoothness_from=2, batch_size=2, save_every=2, figures_every_s=None
)


@pytest.fixture(scope="module")
def stored() -> list[StoredTree]:
    return [stored_tree(make_sample(seed, "sapling"), resolutions=(128,)) for seed in SEEDS]


@pytest.fixture(scope="module")
def shard(stored: list[StoredTree], tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("shards") / "4dtree-00000.safetensors"
    path.write_bytes(written(write_shard, stored))
    return str(path)


def losses(run: PaperTraining, shard: str, folder: Path) -> list[float]:
    seen: list[float] = []
    train_paper(run, [shard], folder, on_step=lambda part, step, total, loss: seen.append(loss))
    return seen


def test_a_resumed_run_has_the_same_losses_through_both_stages(shard: str, tmp_path) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    whole = losses(RUN, shard, tmp_path / "whole")
    first = losses(replace(RUN, num_steps=1), shard, tmp_path / "cut")
    second = losses(RUN, shard, tmp_path / "cut")
    assert len(whole) == 3
    assert [*first, *second] == pytest.approx(whole, rel=1e-4)


def test_trained_weights_load_with_their_preset_step_and_data(shard: str, tmp_path) -> None:
    losses(replace(RUN, num_steps=1, figures_every_s=0.0), shard, tmp_path)
    path = tmp_path / "paper.safetensors"
    model = load_model(str(path))
    assert (model.name, model.resolution) == ("paper", 32)
    stored = read_weights(path)
    assert stored.network(PaperNetwork, "paper").preset == RUN.preset
    assert stored.provenance.step == 1
    assert "| data | 2 trees |" in str(stored.provenance.card)
    assert stored.provenance.data_sha256 == shards_sha256([shard])
    assert stored.tensors["frequency_sizes"].shape == (16,)
    figures = json.loads((tmp_path / "figures.jsonl").read_text())
    assert figures["step"] == 1
    assert np.isfinite(list(figures.values())).all()


@pytest.mark.slow
def test_loading_workers_give_the_same_losses(shard: str, tmp_path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "workers").mkdir()
    alone = losses(RUN, shard, tmp_path / "here")
    assert losses(replace(RUN, num_workers=1), shard, tmp_path / "workers") == pytest.approx(alone, rel=1e-6)


def test_an_example_is_the_stored_tree_on_the_presets_grids(stored: list[StoredTree]) -> None:
    preset = replace(paper_preset(8, 32), encoder_widths=(8, 8, 8))
    tree = stored[0]
    example = paper_example(tree, preset)
    assert example.resolution == 128
    coords = np.unique(example.coords.numpy() >> 2, axis=0)
    assert len(coords) == len(example.spectrum)
    # a voxel's spectrum is the mean of the stored voxels in it, without the known effect of the wind
    own = tree.spectrum(128)
    row = int(np.argmax(np.abs(example.spectrum[:, 1, 0].numpy())))
    inside = (own.grid.coords // 4 == coords[row]).all(axis=1)
    assert inside.any()
    height_m = np.ptp(tree.tensors["vertices"][:, 2])
    restored = (example.spectrum[row].numpy() * wind_sizes(tree.wind, 16)[:, None]) @ wind_axes(tree.wind)
    np.testing.assert_allclose(restored, own.coefficients[inside].mean(axis=0) / height_m, rtol=1e-3, atol=1e-7)
    with pytest.raises(InputError, match="resolution is 48"):
        paper_example(tree, replace(preset, resolution=48))


def test_the_cache_keeps_examples_and_is_filled_once(
    stored: list[StoredTree], shard: str, tmp_path, monkeypatch
) -> None:
    preset = replace(paper_preset(8, 32), encoder_widths=(8, 8, 8))
    first = ExampleCache([shard], preset, tmp_path)
    fresh = paper_example(stored[0], preset)
    assert len(first) == 2
    torch.testing.assert_close(first[0].spectrum, fresh.spectrum, rtol=2e-3, atol=1e-6)
    assert (first[0].coords == fresh.coords).all()
    monkeypatch.setattr("lab.paper.examples.paper_example", None)
    assert len(ExampleCache([shard], preset, tmp_path)) == 2
    with pytest.raises(TypeError):  # another preset has examples of its own
        ExampleCache([shard], replace(preset, num_frequencies=8), tmp_path)


def test_sizes_of_frequencies_make_components_of_unit_size(shard: str, tmp_path) -> None:
    cache = ExampleCache([shard], RUN.preset, tmp_path)
    sizes = frequency_sizes(cache, RUN)
    power = [cache[number].spectrum.abs().square().mean(dim=(0, 2)) / 2 for number in range(2)]
    np.testing.assert_allclose(torch.stack(power).mean(dim=0) / sizes.square(), 1, rtol=1e-3)
    together = frequency_sizes(cache, replace(RUN, by_frequency=False))
    assert (together == together[0]).all()


def test_shards_without_training_trees_are_refused(stored: list[StoredTree], tmp_path) -> None:
    path = tmp_path / "held-out.safetensors"
    path.write_bytes(written(write_shard, [replace(stored[0], split="validation")]))
    with pytest.raises(InputError, match="no trees for training"):
        ExampleCache([str(path)], RUN.preset, tmp_path)


def test_the_papers_batch_is_made_up_of_passes(monkeypatch) -> None:
    assert PaperTraining().options().accumulate == 48
    assert PaperTraining(micro_trees=2, frequencies_per_tree=4).options().accumulate == 6
    monkeypatch.setattr("lab.paper.train.num_processes", lambda: 8)
    assert PaperTraining().options().accumulate == 6


@pytest.mark.slow
def test_two_processes_take_real_steps_under_torchrun(shard: str, tmp_path) -> None:
    command = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "dynamictree.cli", "train"]
    options = {"--preset": "paper", "--steps": 3, "--smoothness-from": 2, "--width": 8, "--resolution": 8}
    more = [str(word) for pair in ({**options, "--batch": 4}).items() for word in pair]
    done = subprocess.run(
        [sys.executable, *command, str(tmp_path / "run"), "--dataset", str(Path(shard).parent), *more, "--json"],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["weights"].endswith("paper.safetensors")
    with safe_open(tmp_path / "run" / "checkpoint.safetensors", "pt") as stored:
        assert json.loads(stored.metadata()["step"]) == 3
        assert all(torch.isfinite(stored.get_tensor(name)).all() for name in stored.keys())  # noqa: SIM118
