"""A model of one's own on the command line."""

from functools import partial
from pathlib import Path

from dynamictree.formats.tensors.spectrum import read_spectrum
from dynamictree.models.paper.network import PaperNetwork, paper_preset
from dynamictree.models.weights_file import write_weights
from tests.commands.conftest import Run, assert_refused

POLE = "\n".join(f"v {x} {y} {z}" for z in (0, 1, 2) for x, y in ((0, 0), (0.1, 0), (0, 0.1))) + "".join(
    f"\nf {a} {b} {b + 3}\nf {a} {b + 3} {a + 3}" for low in (1, 4) for a, b in ((low, low + 1), (low + 1, low + 2))
)


def test_a_file_of_weights_generates_the_motion(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / ("a-folder-of-my-own-models" * 3)  # longer than any name of a model
    folder.mkdir()
    write_weights(PaperNetwork(paper_preset(8, 16)), folder / "mine.safetensors")
    (tmp_path / "pole.obj").write_text(POLE)
    spectrum = tmp_path / "pole.spectrum.safetensors"
    diffuse = partial(run, "diffuse", tmp_path / "pole.obj", "-o", spectrum, "--num-steps", "1", "--model")
    assert diffuse(folder / "mine.safetensors").returncode == 0
    with spectrum.open("rb") as stream:
        assert read_spectrum(stream).model == "mine"
    assert_refused(diffuse("no-such"), "there is no model 'no-such'", at_once=False)
