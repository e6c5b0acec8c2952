"""Splats and scans on the command line."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.commands.conftest import Run, assert_refused
from tests.service.test_clouds import ply_of, post_cloud


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """So thin that it has few voxels."""
    cloud = post_cloud(degree=1)
    thin = replace(cloud, means=cloud.means * np.array([0.1, 0.1, 1], np.float32), scales=cloud.scales / np.float32(4))
    path = tmp_path / "tree.ply"
    path.write_bytes(ply_of(thin))
    return path


def test_a_splat_comes_out_moving(run: Run, tree: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("dynamictree.gaussian.cloud_mesh.MAX_FACES", 400)  # enough for the post
    np.save(tmp_path / "mask.npy", np.arange(400) < 300)
    formats = ["--format", "splat-ply, splat", "--format", "png", "--side-px", "64"]
    motion = ["--num-steps", "1", "--frames", "4", "--no-loop"]
    part = ["--mask", tmp_path / "mask.npy", "--box=-1,-1,-1,1,1,2", "--sh-degree", "0"]
    answer = run("animate", tree, "-o", tmp_path / "out", *formats, *motion, *part)
    assert answer.returncode == 0
    assert "splat-ply: 4 frames: 0.1 MB\n" in answer.stderr
    products = {"splat.ply.zip", "tree.animated-splat.safetensors", "preview.png", "tree.spectrum.safetensors"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == products
    with zipfile.ZipFile(tmp_path / "out" / "splat.ply.zip") as archive:
        assert len(archive.namelist()) == 4


def test_info_tells_what_a_splat_is(run: Run, tree: Path) -> None:
    report = json.loads(run("info", tree, "--json").stdout)
    assert (report["num_gaussians"], report["sh_degree"], report["source_up_axis"]) == (400, 1, "-Y")


@pytest.mark.parametrize(
    ("options", "message"),
    [(["--box=5,5,5,6,6,6"], "nothing is in box_m"), (["--mask", "none.npy"], "none.npy cannot be read")],
)
def test_a_part_that_is_none_is_refused(options: list[str], message: str, tree: Path, tmp_path: Path, run: Run) -> None:
    assert_refused(run("animate", tree, "-o", tmp_path / "out", *options), message, tmp_path / "out", at_once=False)
