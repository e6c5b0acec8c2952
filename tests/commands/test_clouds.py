"""Splats and scans on the command line, in this process."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.service.test_clouds import BAD_CLOUDS, ply_of, post_cloud


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """So thin that it has few voxels."""
    cloud = post_cloud(degree=1)
    thin = replace(cloud, means=cloud.means * np.array([0.1, 0.1, 1], np.float32), scales=cloud.scales / np.float32(4))
    path = tmp_path / "tree.ply"
    path.write_bytes(ply_of(thin))
    return path


def test_a_splat_comes_out_moving(
    dynamictree: Callable[..., int], tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "mask.npy", np.arange(400) < 300)
    output = tmp_path / "out"
    options = [
        "--format",
        "splat-ply, splat",
        "--format",
        "png",
        "--num-steps",
        "1",
        "--frames",
        "4",
        "--no-loop",
        "--side-px",
        "64",
    ]
    part = ["--mask", tmp_path / "mask.npy", "--box=-1,-1,-1,1,1,2", "--sh-degree", "0"]
    assert dynamictree("animate", tree, "-o", output, *options, *part) == 0
    captured = capsys.readouterr()
    assert "splat-ply: 4 frames of 400 Gaussians of SH degree 0: 0.1 MB\n" in captured.err
    names = {path.name for path in output.iterdir()}
    assert names == {
        "splat.ply.zip",
        "tree.animated-splat.safetensors",
        "preview.png",
        "tree.spectrum.safetensors",
    }
    with zipfile.ZipFile(output / "splat.ply.zip") as archive:
        assert len(archive.namelist()) == 4


def test_info_tells_what_a_splat_is(
    dynamictree: Callable[..., int], tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert dynamictree("info", tree, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["num_gaussians"], report["sh_degree"], report["source_up_axis"]) == (400, 1, "-Y")


@pytest.mark.parametrize("what", BAD_CLOUDS)
def test_a_bad_cloud_is_one_line_and_exit_2_and_leaves_nothing(
    what: str, dynamictree: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, content, _, message = BAD_CLOUDS[what]
    (tmp_path / name).write_bytes(content)
    assert dynamictree("animate", tmp_path / name, "-o", tmp_path / "out") == 2
    captured = capsys.readouterr().err
    assert len(captured.strip().splitlines()) == 1
    assert message in captured
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--box=1,2,3"], "six numbers"),
        (["--box=5,5,5,6,6,6"], "nothing is in box_m"),
        (["--mask", "none.npy"], "none.npy cannot be read"),
        (["--share", "0"], "--share is 0"),
        (["--format", "gif"], "--format is 'gif'"),
    ],
)
def test_a_wrong_option_is_reported(
    options: list[str],
    message: str,
    tree: Path,
    tmp_path: Path,
    dynamictree: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert dynamictree("animate", tree, "-o", tmp_path / "out", *options) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
