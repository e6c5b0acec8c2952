"""Licence, notice, citation and changelog agree with the packages."""

import tomllib
from pathlib import Path

import pytest
import yaml

from web.vendor import LIBRARIES

ROOT = Path(__file__).parent.parent
PROJECTS = [ROOT / "pyproject.toml", ROOT / "client" / "pyproject.toml"]


@pytest.mark.parametrize("path", PROJECTS, ids=lambda path: path.parent.name)
def test_packages_declare_the_licence_whose_text_they_carry(path: Path) -> None:
    project = tomllib.loads(path.read_text())["project"]
    assert project["license"] == "Apache-2.0"
    for pattern in project["license-files"]:
        assert list(path.parent.glob(pattern)), pattern
    text = (path.parent / "LICENSE").read_text()
    assert "Apache License" in text
    assert "Copyright [yyyy] [name of copyright owner]" in text  # the plain text, not another project's copy


@pytest.mark.parametrize("library", LIBRARIES, ids=lambda library: library.name)
def test_the_notice_names_every_vendored_library(library) -> None:
    notice = " ".join((ROOT / "NOTICE").read_text().split())
    name = {"three": "three.js", "@sparkjsdev/spark": "Spark", "swagger-ui-dist": "Swagger UI"}.get(
        library.name, library.name
    )
    assert f"{name} {library.version}" in notice
    for path in library.targets:
        if "LICENSE" in path:
            assert f"web/vendor/{path}" in notice


def test_citation_and_changelog_name_the_version() -> None:
    version = tomllib.loads(PROJECTS[0].read_text())["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()
