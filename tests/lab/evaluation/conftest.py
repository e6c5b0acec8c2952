from pathlib import Path

import pytest
import torch
from typer import Typer

from dynamictree.models.small.denoiser import DenoiserShape
from dynamictree.models.small.network import SmallNetwork, SmallPreset
from dynamictree.models.weights_file import write_weights
from lab.commands.evaluate import evaluate
from lab.evaluation.held_out_trees import HeldOutTree, iter_held_out


@pytest.fixture(scope="session")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of a tiny network that never learnt."""
    torch.manual_seed(0)
    shape = DenoiserShape(width=8, embedding=8, num_blocks=1)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    write_weights(SmallNetwork(SmallPreset(amplitude_width=8, amplitude_depth=1, denoiser=shape)), path)
    return path


@pytest.fixture(scope="session")
def palm() -> HeldOutTree:
    """The smallest of the first unseen trees."""
    return min(iter_held_out("unseen-species", 3), key=lambda tree: len(tree.voxels.grid))


@pytest.fixture
def commands() -> Typer:
    app = Typer(pretty_exceptions_enable=False)
    app.command()(evaluate)
    return app
