"""The command line as a user or a script meets it: real files, and one real process for all."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from safetensors.numpy import load_file

from dynamictree.cli import app
from tests.commands.conftest import Run, assert_refused
from tests.service.test_clouds import BAD_CLOUDS


def test_every_command_has_a_name_and_every_option_has_help() -> None:
    commands = dict(leaves(typer.main.get_command(app)))
    assert {"animate", "dataset generate", "evaluate", "interact", "keys create", "remote wait", "serve"} <= set(
        commands
    )
    for name, command in commands.items():
        assert command.help, name
        for parameter in command.params:
            assert parameter.help, f"{name}: {parameter.name}"
            assert not re.search(r"(?<!\\)\[", parameter.help), f"rich reads a unit as markup, {name}: {parameter.help}"
            assert parameter.nargs <= 1 or parameter.metavar, f"{name}: {parameter.name} needs a metavar per word"


def leaves(command: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every command that does something, by its words."""
    if not hasattr(command, "list_commands"):
        yield name.strip(), command
        return
    for word in command.list_commands(None):
        yield from leaves(command.get_command(None, word), f"{name} {word}")


def test_animate_writes_every_product_and_says_so_in_json(triangle: Path, tmp_path: Path) -> None:
    options = ["-o", str(tmp_path / "out"), "--format", "ply,glb,motion,png", "--num-steps", "1", "--json"]
    command = [sys.executable, "-m", "dynamictree.cli", "animate", str(triangle), *options]
    answer = subprocess.run(command, check=False, capture_output=True, text=True, timeout=600)
    assert answer.returncode == 0, answer.stderr
    files = {Path(name).name for name in json.loads(answer.stdout)["files"]}
    assert files == {"motion.ply.zip", "tree.glb", "motion.safetensors", "preview.png", "tree.spectrum.safetensors"}
    motion = load_file(tmp_path / "out" / "motion.safetensors")
    assert motion["displacement"].shape == (100, len(motion["vertices"]), 3)
    assert np.isfinite(motion["displacement"]).all()


def test_the_same_seed_gives_the_same_spectrum_and_another_seed_another(run, triangle, tmp_path) -> None:
    files = {}
    for name, seed in [("a", 1), ("b", 1), ("c", 2)]:
        files[name] = tmp_path / f"{name}.spectrum.safetensors"
        assert run("diffuse", triangle, "-o", files[name], "--seed", seed, "--num-steps", 1).returncode == 0
    assert files["a"].read_bytes() == files["b"].read_bytes()
    assert files["a"].read_bytes() != files["c"].read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("tree.obj", b"v 0 0 0\nv 1 0 0\n", "no faces"),
        ("tree.glb", b"glTF\x02\x00\x00\x00\xff\xff\x00\x00", "truncated"),
        ("tree.doc", b"hello", "doc"),
        *((name, content, message) for name, content, _, message in BAD_CLOUDS.values()),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(run, tmp_path, name, content, message) -> None:
    (tmp_path / name).write_bytes(content)
    assert_refused(run("animate", tmp_path / name, "-o", tmp_path / "out"), message, tmp_path / "out")


def test_frames_that_are_no_loop_are_refused_before_the_work(run: Run, triangle, tmp_path) -> None:
    answer = run("animate", triangle, "-o", tmp_path / "out", "--frames", 24, "--num-steps", 1)
    assert_refused(answer, "24 frames at 24 fps", tmp_path / "out", at_once=False)
    assert "voxelize" not in answer.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fps", "500"], "--fps is 500.0: it should be less than or equal to 240"),
        (["--wind-speed", "31"], "--wind-speed is 31.0: it should be less than or equal to 30"),
        (["--format", "gif"], "--format is 'gif': it should be 'glb', 'glb-morph'"),
        (["--box", "1,2"], "--box is '1,2': six numbers are needed"),
        (["--resolution", "32"], "--resolution is 32: it should be 128, 256 or 512"),
        (["--up-axis", "up"], "--up-axis is 'up'"),
        (["--share", "0"], "--share is 0"),
    ],
)
def test_a_value_out_of_range_is_one_line_that_names_the_option(run: Run, arguments: list[str], message: str) -> None:
    assert_refused(run("animate", "no-such.obj", "-o", "no-such-folder", *arguments), message)
