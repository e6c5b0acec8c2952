"""What is told of a child that gave no answer."""

import asyncio
from pathlib import Path

import pytest

from jobs.parser_process import ParseRequest, parse
from jobs.settings import Settings


def test_a_fault_of_ours_is_told_as_one_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
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
