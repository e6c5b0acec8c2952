"""Tools of other projects that run on Node: `make js-tools` installs them, a test without them is skipped."""

import json
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
JS_TOOLS = ROOT / ".cache" / "js-tools"


def by_node(script: str, *arguments: str | Path, package: str) -> str:
    """What a script of `tests/js` prints; it needs a package."""
    if not (JS_TOOLS / "node_modules" / package).exists() or shutil.which("node") is None:
        pytest.skip(f"{package} is not there: make js-tools, with node and npm")
    command = ["node", str(ROOT / "tests" / "js" / script), str(JS_TOOLS), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def in_node(program: str, *arguments: object) -> Any:
    """The JSON that a module of ours prints."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    command = ["node", "--input-type=module", "--eval", program, *map(str, arguments)]
    return json.loads(subprocess.run(command, capture_output=True, check=True, timeout=120).stdout)


def validated(files: Iterable[Path]) -> list[dict[str, Any]]:
    """Reports of the Khronos glTF validator."""
    reports: list[dict[str, Any]] = json.loads(by_node("validate_gltf.cjs", *files, package="gltf-validator"))
    return reports
