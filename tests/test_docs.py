"""What the documents name exists."""

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
NAMES = sorted(
    set(
        re.findall(r"`((?:dynamictree|benchmarks|service|worker)(?:\.\w+)+)`", (ROOT / "docs/paper_map.md").read_text())
    )
)


@pytest.mark.parametrize("name", NAMES)
def test_the_paper_map_names_what_exists(name: str) -> None:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError:
        module, attribute = name.rsplit(".", 1)
        assert hasattr(importlib.import_module(module), attribute), name


def test_the_paper_map_has_every_equation() -> None:
    table = (ROOT / "docs/paper_map.md").read_text().split("## Equations")[1].split("## Sections")[0]
    assert set("1234567") <= set(re.findall(r"^\| (\d) \|", table, re.MULTILINE))


def test_the_readme_maps_folders_that_exist() -> None:
    drawn = re.findall(r"^    (\S.*?/.*?)  ", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert len(drawn) == 12
    for path in ", ".join(drawn).split(", "):
        assert (ROOT / path.strip()).is_dir(), path


def test_the_readme_names_commands_and_files_that_exist() -> None:
    readme = (ROOT / "README.md").read_text()
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"`make (\w+)", readme):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    for path in re.findall(r"\]\(((?:docs|openapi|dynamictree|benchmarks|recipes)[^)#]*)\)", readme):
        assert (ROOT / path).exists(), path
