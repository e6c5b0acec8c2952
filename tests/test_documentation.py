"""The documentation builds without a network, its links lead somewhere, what it names exists, versions agree."""

import ast
import importlib.util
import json
import pkgutil
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
import yaml

from dynamictree.cli import app
from recipes.api_reference import reference_page
from service.http.problems import KINDS
from web.vendor import LIBRARIES

ROOT = Path(__file__).parent.parent
PAGES = [
    *sorted((ROOT / "docs").glob("*.md")),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "client/README.md")),
]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
KINDS_OF_BLOCK = "cs python sh json hlsl glsl toml ini yaml text js nginx promql http html sql ts dockerfile"


def blocks(*languages: str) -> Iterator[pytest.param]:
    for page in PAGES:
        if page.name == "api.md":  # made, not written
            continue
        for number, (language, text) in enumerate(BLOCK.findall(page.read_text())):
            if not languages or language in languages:
                yield pytest.param(text, id=f"{page.stem}-{number}-{language}")


def test_modules_that_are_named_exist() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    paths = {f"/{path}" for path in listed}
    readable = [
        path
        for path in listed
        if re.match(r"(docs|dynamictree|jobs|service|web/(?!vendor)|worker)/.*\.(py|md|js)", path)
    ]
    missing = [
        f"{path}: {name}"
        for path in readable
        for name in re.findall(r"`([\w/]+\.py)`|see ([\w/]+\.js)\b", (ROOT / path).read_text())
        for name in filter(None, name)
        if name != "pydantic.py"  # an attacker's, in an example
        and not any(file.endswith(f"/{name}") for file in paths)
    ]
    assert missing == []


def test_every_problem_has_an_entry_and_every_entry_is_a_problem() -> None:
    entries = re.findall(
        r"^\| `([a-z-]+)`\{ #\1 \} \|", (ROOT / "docs" / "troubleshooting.md").read_text(), re.MULTILINE
    )
    assert sorted(entries) == sorted(KINDS)


def test_blocks_say_what_they_are() -> None:
    for page in PAGES:
        assert {language for language, _ in BLOCK.findall(page.read_text())} <= set(KINDS_OF_BLOCK.split()), page
        assert page.read_text().count("```") == 2 * len(BLOCK.findall(page.read_text())), page


@pytest.mark.parametrize("text", list(blocks("python")))
def test_python_is_python_that_imports_what_is_there(text: str) -> None:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            module = importlib.import_module(node.module)
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                assert hasattr(module, alias.name) or importlib.util.find_spec(submodule), submodule


@pytest.mark.parametrize("text", list(blocks("json")))
def test_json_is_json(text: str) -> None:
    json.loads(text)


@pytest.mark.parametrize("text", list(blocks("sh")))
def test_shell_blocks_call_what_is_there(text: str) -> None:
    subprocess.run(["bash", "-n"], input=text, text=True, check=True, capture_output=True)
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for target in re.findall(r"^make ([a-z-]+)", text, re.MULTILINE):
        assert target in targets
    for module in re.findall(r"python -m ((?:recipes|benchmarks|service|worker)[\w.]*)", text):
        assert importlib.util.find_spec(module), module
    joined = re.sub(r"\\\n\s*", "", text)
    for line in re.findall(r"^dynamictree (.+?)(?: [&|>#].*)?$", joined, re.MULTILINE):
        _check_command(line.split())


def _check_command(words: list[str]) -> None:
    command = typer.main.get_command(app)
    while words and hasattr(command, "get_command"):
        name, *words = words
        if name.startswith("-"):
            assert name in ("--help", "-h")
            return
        resolved = command.get_command(None, name)
        assert resolved is not None, name
        command = resolved
    options = {option for parameter in command.params for option in [*parameter.opts, *parameter.secondary_opts]}
    for word in words:
        if word.startswith("-") and not re.fullmatch(r"-?[\d.]+", word):
            assert word in options | {"--help", "-h"}, f"{command.name} {word}"


def test_the_reference_tells_every_operation_and_body() -> None:
    page = json.loads((ROOT / "openapi" / "openapi.json").read_text())
    headings = set(re.findall(r"^### (\w+)$", reference_page(page), re.MULTILINE))
    operations = {operation["operationId"] for item in page["paths"].values() for operation in item.values()}
    assert headings == operations | set(page["components"]["schemas"])


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Built anew, strictly, in a folder of its own."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "docs", folder / "docs")
    shutil.copy(ROOT / "zensical.toml", folder)
    page = json.loads((ROOT / "openapi" / "openapi.json").read_text())
    (folder / "docs" / "api.md").write_text(reference_page(page))
    zensical = Path(sys.executable).with_name("zensical")
    built = subprocess.run([zensical, "build", "--strict"], cwd=folder, capture_output=True, text=True, check=False)
    assert built.returncode == 0, re.sub(r"\x1b\[[0-9;]*m", "", built.stdout)
    return folder / "site"


def test_the_site_asks_other_hosts_for_nothing(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text()
        loaded = re.findall(r"<(?:script|img|iframe|source)[^>]+src=[\"']?([^\"' >]+)", text)
        loaded += re.findall(r"<link[^>]+href=[\"']?([^\"' >]+)", text)
        assert [address for address in loaded if address.startswith(("http:", "https:", "//"))] == [], page


def test_every_page_is_in_the_navigation_and_every_link_leads_to_a_file(site: Path) -> None:
    start = (site / "index.html").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        if page.name != "index.md":
            assert f"{page.stem}/" in start, f"{page.name} is not in the nav of zensical.toml"
    for page in site.rglob("*.html"):
        if page.name == "404.html":
            continue
        for link in re.findall(r"<a[^>]+href=[\"']?([^\"' >#?]+)", page.read_text()):
            if not re.match(r"[a-z]+:", link):
                target = (page.parent / link).resolve()
                assert target.exists(), f"{page.relative_to(site)} leads to {link}"


def test_the_paper_map_has_every_equation_and_names_what_exists() -> None:
    page = (ROOT / "docs/paper_map.md").read_text()
    table = page.split("## Equations")[1].split("## Sections")[0]
    assert set("1234567") <= set(re.findall(r"^\| (\d) \|", table, re.MULTILINE))
    for name in set(re.findall(r"`((?:dynamictree|benchmarks|service|worker)(?:\.\w+)+)`", page)):
        pkgutil.resolve_name(name)


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


@pytest.mark.parametrize("path", [ROOT / "pyproject.toml", ROOT / "client" / "pyproject.toml"])
def test_packages_declare_the_licence_whose_text_they_carry(path: Path) -> None:
    project = tomllib.loads(path.read_text())["project"]
    assert project["license"] == "Apache-2.0"
    for pattern in project["license-files"]:
        assert list(path.parent.glob(pattern)), pattern
    assert "Copyright [yyyy] [name of copyright owner]" in (path.parent / "LICENSE").read_text()  # the plain text


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
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()
