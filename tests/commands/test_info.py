import json
from hashlib import sha256
from pathlib import Path

import pytest

from tests.commands.conftest import TRIANGLE, Run, assert_refused


def test_a_file_is_described_by_its_bytes(run: Run, triangle: Path, tmp_path: Path) -> None:
    voxels, spectrum = tmp_path / "a", tmp_path / "b"
    report = json.loads(run("voxelize", triangle, "-o", voxels, "--json").stdout)
    assert run("diffuse", voxels, "-o", spectrum, "--num-steps", 1).returncode == 0
    source_line = f"source_sha256: {sha256(TRIANGLE).hexdigest()}"
    for path, line in ((triangle, "num_faces: 1"), (voxels, "resolution: 128"), (spectrum, source_line)):
        assert line in run("info", path).stdout.splitlines()
    assert json.loads(run("info", voxels, "--json").stdout)["num_voxels"] == report["num_voxels"] > 100


@pytest.mark.parametrize("name", ["tree.obj", "source/tree.obj"])
def test_a_folder_stands_for_the_one_shape_in_it(run: Run, name: str, tmp_path: Path) -> None:
    for other in ("textures/bark.png", "license.txt", "._tree.obj", "__MACOSX/._tree.obj", name):
        (tmp_path / other).parent.mkdir(exist_ok=True)
        (tmp_path / other).write_bytes(TRIANGLE)
    assert "num_faces: 1" in run("info", tmp_path).stdout.splitlines()


@pytest.mark.parametrize(
    ("names", "line"),
    [
        ((), "is a folder, and no file in it ends in .obj, .ply"),
        (("a.jpg", "b.jpg"), "is a folder of pictures; `dynamictree reconstruct` makes a tree of photos"),
        (("a.obj", "b.ply"), "holds 2 shapes: a.obj, b.ply; name one of them"),
        (("meta.json", "means_l.webp"), "the SOG file is of version 1; 2 is understood"),
    ],
)
def test_a_folder_without_one_shape_is_refused(run: Run, names: tuple[str, ...], line: str, tmp_path: Path) -> None:
    for name in names:
        (tmp_path / name).write_text('{"means": {}, "quats": {}, "scales": {}}')
    assert_refused(run("animate", tmp_path, "-o", tmp_path / "out"), line, at_once=False)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("voxelize triangle.obj -o .", "is a directory"),
        ("voxelize triangle.obj -o triangle.obj/v", "nothing can be written to triangle.obj: File exists"),
        ("interact . -o out", ". is a folder; name a file in it"),
        ("info x.voxels.safetensors", "the file is no surface-voxels"),
        ("anmate triangle.obj", "Did you mean 'animate'?"),
    ],
)
def test_what_is_wrong_is_reported(run, triangle, words, line, monkeypatch) -> None:
    monkeypatch.chdir(triangle.parent)
    Path("x.voxels.safetensors").write_bytes(TRIANGLE)
    assert_refused(run(*words.split()), line, at_once=False)
    assert sorted(path.name for path in Path().iterdir()) == ["triangle.obj", "x.voxels.safetensors"]
