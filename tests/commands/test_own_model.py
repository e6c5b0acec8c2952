"""A model of one's own on the command line."""

from collections.abc import Callable
from pathlib import Path

import pytest

from dynamictree.formats.tensors.spectrum import read_spectrum
from dynamictree.models.paper.network import PaperNetwork, paper_preset
from dynamictree.models.weights_file import write_weights

POLE = "\n".join(f"v {x} {y} {z}" for z in (0, 1, 2) for x, y in ((0, 0), (0.1, 0), (0, 0.1))) + "".join(
    f"\nf {a} {b} {b + 3}\nf {a} {b + 3} {a + 3}" for low in (1, 4) for a, b in ((low, low + 1), (low + 1, low + 2))
)


def test_a_file_of_weights_generates_the_motion(
    dynamictree: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / ("a-folder-of-my-own-models" * 3)  # longer than any name of a model
    folder.mkdir()
    write_weights(PaperNetwork(paper_preset(8, 16)), folder / "mine.safetensors")
    (tmp_path / "pole.obj").write_text(POLE)
    spectrum = tmp_path / "pole.spectrum.safetensors"
    options = ["-o", spectrum, "--num-steps", "1"]
    assert dynamictree("diffuse", tmp_path / "pole.obj", *options, "--model", folder / "mine.safetensors") == 0
    with spectrum.open("rb") as stream:
        assert read_spectrum(stream).model == "mine"
    assert dynamictree("diffuse", tmp_path / "pole.obj", *options, "--model", "no-such") == 2
    assert "there is no model 'no-such'" in capsys.readouterr().err
