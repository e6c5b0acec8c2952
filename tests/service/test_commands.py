"""`serve`, `keys` and what stores and deletes a state, as commands."""

import json
import socket
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path

import pytest
import typer
from sqlalchemy.engine import make_url
from typer.testing import CliRunner

from jobs.clients.keys import keys as all_keys
from jobs.settings import Settings
from jobs.storage.stage_files import HALF_DONE
from jobs.store import Store
from service.local.keys import app as keys
from service.local.serve import clear_scratch, listen, lock_file, plans, redis_plan, require_keys_beyond_loopback, serve
from service.local.stored_state import backup, erase, restore, scrub
from service.services import open_services

app = typer.Typer()
app.command("serve")(serve)
for command in (backup, restore, scrub, erase):
    app.command(command.__name__)(command)


def test_a_state_of_an_earlier_revision_is_one_line(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "jobs.sqlite") as earlier:
        earlier.execute("CREATE TABLE jobs (id TEXT)")
    earlier.close()
    done = CliRunner().invoke(app, ["serve", "--state-dir", str(tmp_path)])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert "another state folder" in done.stderr


@pytest.mark.parametrize(
    ("command", "variable", "value", "words"),
    [
        ("serve", "LEASE_S", "-1", "DYNAMICTREE_LEASE_S is '-1': "),
        *(
            (command, "DATABASE_URL", "sqlite:///FOLDER", "unable to open database file")
            for command in ("serve", "list")
        ),
    ],
)
def test_what_cannot_be_used_is_one_line(tmp_path, monkeypatch, command, variable, value, words) -> None:
    monkeypatch.setenv(f"DYNAMICTREE_{variable}", value.replace("FOLDER", str(tmp_path)))
    done = CliRunner().invoke(keys if command == "list" else app, [command, "--state-dir", str(tmp_path)])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert words in done.stderr
    assert f"DYNAMICTREE_{variable}" in done.stderr


def test_a_port_that_is_taken_is_named(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = CliRunner().invoke(app, ["serve", "--port", str(port), "--state-dir", str(tmp_path)])
    assert done.exit_code == 2
    assert f"port {port}" in done.stderr


def test_a_state_folder_has_one_owner(tmp_path: Path) -> None:
    lease = lock_file(tmp_path / "serve.lock")
    with pytest.raises(OSError, match="in use"):
        lock_file(tmp_path / "serve.lock")
    lease.close()
    lock_file(tmp_path / "serve.lock").close()


def test_half_done_reconstructions_outlast_a_restart(tmp_path: Path) -> None:
    clear_scratch(tmp_path / "none yet")
    for name in (f"{HALF_DONE}a-40", "job-b-1"):
        (tmp_path / name).mkdir()
    (tmp_path / "upload").touch()
    clear_scratch(tmp_path)
    assert [left.name for left in tmp_path.iterdir()] == [f"{HALF_DONE}a-40"]


def test_only_the_owner_of_the_process_reads_what_is_stored(tmp_path: Path) -> None:
    settings = Settings(state_dir=tmp_path / "new")
    lock_file(settings.state_dir / "serve.lock").close()
    redis_plan(settings)
    with open_services(settings):
        pass
    for folder in ("new", "new/redis", "new/artifacts", "new/artifacts/uploads"):
        assert (tmp_path / folder).stat().st_mode & 0o777 == 0o700, folder
    assert (tmp_path / "new" / "jobs.sqlite").stat().st_mode & 0o777 == 0o600


def test_where_redis_has_a_url_none_is_started(tmp_path: Path) -> None:
    listening = listen("127.0.0.1", 0)
    own = plans(Settings(state_dir=tmp_path), listening)
    other = plans(Settings(state_dir=tmp_path, redis_url="redis://host/0"), listening)
    listening.close()
    assert [plan.name for plan in own] == ["redis", "api", "worker", "housekeeper"]
    assert [plan.name for plan in other] == ["api", "worker", "housekeeper"]


def test_nobody_else_is_let_in_without_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = CliRunner().invoke(app, ["serve", "--host", "0.0.0.0", "--state-dir", str(tmp_path)])
    assert refused.exit_code == 2
    assert "DYNAMICTREE_KEYS=required" in refused.output
    for host, mode in (("127.0.0.1", "loopback"), ("::1", "loopback"), ("0.0.0.0", "required"), ("0.0.0.0", "none")):
        require_keys_beyond_loopback(host, Settings(state_dir=tmp_path, keys=mode))  # type: ignore[arg-type]


def test_a_key_is_made_shown_once_listed_and_revoked(tmp_path: Path) -> None:
    at = ["--state-dir", str(tmp_path / "state")]
    arguments = "create farm --owner ann --scope read --limit reads_per_min=5 --expires-days 1"
    created = CliRunner().invoke(keys, [*arguments.split(), *at])
    assert created.stdout.startswith("dt_")
    listed = CliRunner().invoke(keys, ["list", *at]).stdout
    assert created.stdout.strip() not in listed
    key_id, state, owner, scopes, name, *_ = listed.split()
    assert (state, owner, scopes, name) == ("valid", "ann", "read", "farm")
    [record] = all_keys(Store.open(f"sqlite:///{tmp_path / 'state' / 'jobs.sqlite'}"))
    assert (record.id, record.limits) == (key_id, {"reads_per_min": 5})
    assert record.expires_at is not None
    assert CliRunner().invoke(keys, ["revoke", key_id, *at]).exit_code == 0
    assert "revoked" in CliRunner().invoke(keys, ["list", *at]).stdout
    assert CliRunner().invoke(keys, ["revoke", key_id, *at]).exit_code == 2
    for wrong in (["--scope", "fly"], ["--limit", "jobs=3"], ["--limit", "bytes=-1"]):
        assert CliRunner().invoke(keys, ["create", "x", *wrong, *at]).exit_code == 2


@pytest.mark.parametrize("command", [["backup", "b"], ["scrub"], ["erase", "ann", "--yes"]])
def test_no_empty_state_is_made_where_a_service_s_own_is_meant(command, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code == 2
    assert "--state-dir" in refused.output
    assert list(tmp_path.iterdir()) == []


def test_a_state_is_backed_up_and_restored_by_commands(tmp_path: Path) -> None:
    old, new, folder = (str(tmp_path / name) for name in ("old", "new", "backup"))
    CliRunner().invoke(keys, ["create", "farm", "--owner", "ann", "--state-dir", old])
    steps = [["backup", folder, "--state-dir", old], ["restore", folder, "--state-dir", new]]
    steps += [[*command, "--state-dir", new] for command in (["scrub"], ["erase", "ann", "--yes"])]
    for step in steps:
        done = CliRunner().invoke(app, step)
        assert done.exit_code == 0, (step, done.output)
    assert json.loads(done.output)["keys"] == 1


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


def test_a_database_and_models_of_the_current_folder_are_the_same_for_the_children(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DYNAMICTREE_MODELS", "models")
    settings = Settings(state_dir=Path("state"), database_url="sqlite:///jobs.sqlite")
    with closing(socket.socket()) as listening:
        children = {plan.name: plan.environment for plan in plans(settings, listening)}
    assert make_url(children["worker"]["DYNAMICTREE_DATABASE_URL"]).database == str(tmp_path / "jobs.sqlite")
    assert children["worker"]["DYNAMICTREE_MODELS"] == str(tmp_path / "models")
