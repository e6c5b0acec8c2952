"""The error that reports a child which gave no answer."""

import asyncio
from pathlib import Path

import pytest

from jobs.parser_process import ParseRequest, parse
from jobs.settings import Settings


def test_a_fault_of_ours_is_reported_as_one_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    settings = Settings(state_dir=tmp_path)
    request = ParseRequest(
        kind="mesh",
        names=("tree.obj",),
        paths=(tmp_path / "absent",),
        prepared=tmp_path / "prepared",
        memory_bytes=settings.parser_memory_bytes,
        cpu_s=settings.parser_cpu_s,
    )
    answer = asyncio.run(parse(request, settings))
    assert (answer.code, answer.message) == ("internal-error", "The cause was logged.")
    assert "FileNotFoundError" in caplog.text


def test_modules_of_the_current_folder_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of someone's downloads may hold a `pydantic.py`."""
    (tmp_path / "pydantic.py").write_text("import pathlib; pathlib.Path(__file__).with_name('executed').touch()")
    scene = tmp_path / "scene"
    scene.mkdir()
    tree = scene / "tree.obj"
    tree.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    monkeypatch.chdir(tmp_path)
    settings = Settings(state_dir=tmp_path)
    request = ParseRequest(
        kind="mesh",
        names=("tree.obj",),
        paths=(tree,),
        prepared=scene / "prepared",
        memory_bytes=settings.parser_memory_bytes,
        cpu_s=settings.parser_cpu_s,
    )
    answer = asyncio.run(parse(request, settings))
    assert answer.kind == "mesh", answer
    assert not (tmp_path / "executed").exists()
