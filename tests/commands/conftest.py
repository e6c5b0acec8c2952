import sys
from pathlib import Path
from subprocess import CompletedProcess
from typing import Protocol

import pytest

from dynamictree.cli import main

TRIANGLE = b"v 0 0 0\nv 0.02 0 0\nv 0 0 1\nf 1 2 3\n"  # thin: few voxels


@pytest.fixture
def triangle(tmp_path: Path) -> Path:
    path = tmp_path / "triangle.obj"
    path.write_bytes(TRIANGLE)
    return path


class Run(Protocol):
    def __call__(self, *arguments: str | float | Path) -> CompletedProcess[str]: ...


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """The command line, in this process."""

    def call(*arguments: str | float | Path) -> CompletedProcess[str]:
        words = ["dynamictree", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as ended:
            main()
        return CompletedProcess(words, int(ended.value.code or 0), *capsys.readouterr())

    return call


def assert_refused(
    answer: CompletedProcess[str], message: str, leaves: Path | None = None, *, at_once: bool = True
) -> None:
    """Exit status 2, nothing left of what was to be written, and one line that says why where nothing had begun."""
    assert answer.returncode == 2
    assert message in answer.stderr
    assert leaves is None or not leaves.exists()
    assert not at_once or len(answer.stderr.strip().splitlines()) == 1, answer.stderr
