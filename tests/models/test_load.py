"""Models by name and from files of either kind."""

import pytest
import torch

from dynamictree.errors import InputError
from dynamictree.models import load_model
from dynamictree.models.paper.generate import PaperModel
from dynamictree.models.paper.network import PaperNetwork, paper_preset
from dynamictree.models.small.generate import SmallModel
from dynamictree.models.weights_file import Provenance, read_weights, write_weights
from dynamictree.weights import ENVIRONMENT_VARIABLE, list_weights


def test_every_model_that_is_listed_loads() -> None:
    assert "small" in list_weights()
    for name in list_weights():
        assert load_model(name).name == name
    assert isinstance(load_model("small"), SmallModel)


def test_a_file_of_the_papers_kind_loads_with_what_is_known_of_it(tmp_path) -> None:
    path = tmp_path / "own.safetensors"
    write_weights(PaperNetwork(paper_preset(8, 16)), path, Provenance(step=7, data_sha256="abc", card="# own"))
    model = load_model(str(path))
    assert isinstance(model, PaperModel)
    assert (model.name, model.resolution) == ("own", 64)
    assert read_weights(path).provenance == Provenance(step=7, data_sha256="abc", card="# own")


def test_a_folder_of_models_joins_the_shipped_ones(tmp_path, monkeypatch) -> None:
    torch.manual_seed(0)
    write_weights(PaperNetwork(paper_preset(8, 16)), tmp_path / "mine.safetensors")
    with pytest.raises(InputError, match=r"no model 'mine'; available: .*small"):
        load_model("mine")
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, str(tmp_path))
    (tmp_path / "checkpoint.safetensors").write_bytes(b"a run's state")
    assert {"mine", "small"} <= list_weights().keys()
    assert "checkpoint" not in list_weights()
    assert load_model("mine").name == "mine"
