"""What `dynamictree serve` starts, wherever it is started."""

import socket
import subprocess
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy.engine import make_url

from jobs.settings import Settings
from service.local.serve import plans


def test_modules_of_the_current_folder_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pydantic.py").write_text("import pathlib; pathlib.Path(__file__).with_name('executed').touch()")
    monkeypatch.chdir(tmp_path)
    with closing(socket.socket()) as listening:
        children = {plan.name: plan for plan in plans(Settings(state_dir=Path("state")), listening)}
    commands = {name: [children[name].command[0], "-c", "import pydantic"] for name in ("api", "housekeeper")}
    worker = list(children["worker"].command)
    commands["worker"] = [*worker[: worker.index("worker")], "report"]
    for name, command in commands.items():
        environment = dict(children[name].environment)
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
        assert not (tmp_path / "executed").exists(), name
        assert done.returncode == 0, (name, done.stderr)


def test_a_database_and_models_of_the_current_folder_are_the_same_for_the_children(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DYNAMICTREE_MODELS", "models")
    settings = Settings(state_dir=Path("state"), database_url="sqlite:///jobs.sqlite")
    with closing(socket.socket()) as listening:
        children = {plan.name: plan.environment for plan in plans(settings, listening)}
    assert make_url(children["worker"]["DYNAMICTREE_DATABASE_URL"]).database == str(tmp_path / "jobs.sqlite")
    assert children["worker"]["DYNAMICTREE_MODELS"] == str(tmp_path / "models")
    assert children["worker"]["MALLOC_ARENA_MAX"] == "1"  # as the tests of memory have it
    assert children["api"]["MALLOC_MMAP_THRESHOLD_"] == "131072"
