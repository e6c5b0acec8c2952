"""The page in Firefox, where Debian's and a virtual display are installed; all else is tested in Chromium."""

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import PICTURES
from tests.js_tools import by_node

NAMES = ("firefox", "firefox-esr")


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A virtual screen, on which Mesa draws WebGL in software."""
    server = shutil.which("Xvfb")
    if server is None:
        pytest.skip("Xvfb is not there: install Debian's xvfb, which Firefox needs to draw WebGL")
    read, write = os.pipe()
    command = [server, "-displayfd", str(write), "-screen", "0", "1300x1000x24"]
    with subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL) as screen:
        os.close(write)
        with os.fdopen(read) as number:
            monkeypatch.setenv("DISPLAY", f":{number.readline().strip()}")
        monkeypatch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
        yield
        screen.terminate()


@pytest.fixture
def visit(display: None, url: str, tree: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    installed = os.environ.get("FIREFOX_PATH") or next(filter(None, map(shutil.which, NAMES)), None)
    if installed is None:
        pytest.skip("Firefox is not there: install Debian's firefox-esr, or set FIREFOX_PATH")
    monkeypatch.setenv("FIREFOX_PATH", installed)
    seen: dict[str, Any] = json.loads(by_node("firefox.mjs", url, tree, PICTURES, package="puppeteer-core"))
    return seen


def test_a_tree_goes_in_moves_and_answers_a_pull(visit: dict[str, Any]) -> None:
    assert visit == {
        "complaints": [],
        "welcomeMoves": True,
        "welcomeViolations": [],
        "standsStill": True,
        "pulled": True,
        "movingViolations": [],
    }
