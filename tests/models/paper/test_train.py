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
from scipy.spatial import cKDTree

from dynamictree.dataset.sample import make_sample
from dynamictree.dataset.shards import StoredTree, store, write_shard
from dynamictree.errors import InputError
from dynamictree.models.paper.network import PaperTraining, paper_preset
from dynamictree.models.paper.train import (
    PaperRun,
    frequency_sizes,
    one_size,
    paper_example,
    train_paper,
    training_places,
)

SEEDS = (1, 2)
RUN = PaperRun(
    preset=paper_preset(8),
    training=PaperTraining(num_iterations=4, smoothness_from=2, batch_size=2),
    resolution=8,
    save_every=2,
)


@pytest.fixture(scope="module")
def stored() -> list[StoredTree]:
    return [store(make_sample(seed, "sapling"), resolutions=(128,)) for seed in SEEDS]


@pytest.fixture(scope="module")
def shard(stored: list[StoredTree], tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("shards") / "4dtree-00000.safetensors"
    with path.open("wb") as stream:
        write_shard(stored, stream)
    return str(path)


def losses(run: PaperRun, shard: str, folder: Path) -> list[float]:
    told: list[float] = []
    train_paper(run, [shard], folder, on_step=lambda part, step, total, loss: told.append(loss))
    return told


def test_a_run_gone_on_with_has_the_same_losses_through_both_stages(shard: str, tmp_path: Path) -> None:
    (tmp_path / "whole").mkdir()
    (tmp_path / "cut").mkdir()
    whole = losses(RUN, shard, tmp_path / "whole")
    half = replace(RUN, training=replace(RUN.training, num_iterations=2))
    first = losses(half, shard, tmp_path / "cut")
    second = losses(RUN, shard, tmp_path / "cut")
    assert len(whole) == 4
    assert [*first, *second] == pytest.approx(whole, rel=1e-4)
    with safe_open(tmp_path / "whole" / "paper.safetensors", "pt") as weights:
        assert weights.get_tensor("frequency_sizes").shape == (16,)


def test_the_fine_grid_ends_on_the_grid_of_the_spectrum(stored: list[StoredTree]) -> None:
    example = paper_example(stored[0], resolution=32, halvings=2, num_levels=2)
    level = example.grids.levels[2]
    assert len(level) == len(example.spectrum) == len(example.centres_m)
    assert example.positions.abs().max() < 1
    # a voxel's spectrum is the mean of the stored voxels in it
    own = stored[0].spectrum(128)
    row = int(np.argmax(np.abs(example.spectrum[:, 1, 0].numpy())))
    inside = (own.grid.coords // 4 == level.coords[row].numpy()).all(axis=1)
    assert inside.any()
    height_m = np.ptp(stored[0].tensors["vertices"][:, 2])
    np.testing.assert_allclose(example.spectrum[row], own.coefficients[inside].mean(axis=0) / height_m, rtol=1e-4)
    far, _ = cKDTree(own.grid.centres_m).query(example.centres_m)
    assert far.max() < 4 * own.grid.voxel_size_m
    with pytest.raises(InputError, match="resolution is 48"):
        paper_example(stored[0], resolution=48, halvings=0, num_levels=1)


def test_sizes_of_frequencies_make_components_of_unit_size(stored: list[StoredTree]) -> None:
    sizes = frequency_sizes([stored[0]], 16)
    relative = stored[0].spectrum(128).coefficients / np.ptp(stored[0].tensors["vertices"][:, 2])
    scaled = relative / sizes.numpy()[:, None]
    power = (np.abs(scaled) ** 2).mean(axis=(0, 2)) / 2
    np.testing.assert_allclose(power, 1, rtol=1e-3)
    together = one_size(sizes)
    assert (together == together[0]).all()
    uneven = (np.abs(relative / together.numpy()[:, None]) ** 2).mean(axis=(0, 2)) / 2
    assert uneven[1:].mean() == pytest.approx(1, rel=1e-3)
    assert uneven[1] > 10 * uneven[10]


def test_shards_without_training_trees_are_refused(stored: list[StoredTree], tmp_path: Path) -> None:
    path = tmp_path / "held-out.safetensors"
    with path.open("wb") as stream:
        write_shard([replace(stored[0], split="validation")], stream)
    with pytest.raises(InputError, match="no trees for training"):
        training_places([str(path)])


def test_the_papers_pace_gives_its_batch_on_any_number_of_processes() -> None:
    run = PaperRun()
    for processes in (1, 8):
        assert run.pace(processes).accumulate * processes == 48
    pace = run.pace(8)
    assert pace.rate_at(0) == pytest.approx(1e-4)
    assert pace.rate_at(20_000) == pytest.approx(5e-5)
    assert pace.rate_at(69_999) == pytest.approx(1.25e-5)


@pytest.mark.slow
def test_two_processes_take_real_steps_under_torchrun(shard: str, tmp_path: Path) -> None:
    command = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "dynamictree.cli", "train"]
    options = {"--preset": "paper", "--paper-steps": 3, "--smoothness-from": 2, "--width": 8, "--resolution": 8}
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
    with safe_open(tmp_path / "run" / "paper.checkpoint.safetensors", "pt") as stored:
        assert json.loads(stored.metadata()["step"]) == 3
        assert all(torch.isfinite(stored.get_tensor(name)).all() for name in stored.keys())  # noqa: SIM118
