from pathlib import Path

import pytest
from typer import Typer

from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.weights_file import write_weights
from lab.commands.evaluate import evaluate
from lab.evaluation.held_out_trees import HeldOutTree, iter_held_out


@pytest.fixture
def untrained(tiny_network: SmallNetwork, tmp_path) -> Path:
    """Weights of a tiny network that never learnt."""
    write_weights(tiny_network, tmp_path / "tiny.safetensors")
    return tmp_path / "tiny.safetensors"


@pytest.fixture(scope="session")
def palm() -> HeldOutTree:
    """The smallest of the first unseen trees."""
    return min(iter_held_out("unseen-species", 3), key=lambda tree: len(tree.voxels.grid))


@pytest.fixture
def commands() -> Typer:
    app = Typer(pretty_exceptions_enable=False)
    app.command()(evaluate)
    return app
