"""`dynamictree backup`, `restore`, `scrub` and `erase`: the whole of what the service stores."""

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy.engine import make_url

from jobs.errors import SettingsError
from jobs.storage.artifacts import ArtifactStore, open_artifacts
from jobs.storage.backup import back_up
from jobs.storage.backup import restore as restore_backup
from jobs.storage.backup import scrub as read_again
from jobs.storage.erasure import erase_owner
from jobs.storage.upload_parts import open_parts
from jobs.store import Store
from service.local.command_line import StateDir, one_line, settings_of

Folder = Annotated[Path, typer.Argument(help="Folder of the backup.")]


def backup(folder: Folder, state_dir: StateDir = None) -> None:
    """Save database and files to a folder, while the service runs. Existing files are not copied again."""
    with _opened("backup", state_dir) as (store, artifacts):
        report = back_up(store, artifacts, folder)
    typer.echo(json.dumps(asdict(report)))
    if report.damaged:
        typer.echo(f"{len(report.damaged)} files are missing or damaged, and are not in the backup", err=True)
        raise typer.Exit(1)


def restore(folder: Folder, state_dir: StateDir = None) -> None:
    """Restore a backup to an empty state folder. Stop the service first; running jobs start again."""
    with _opened("restore", state_dir, must_exist=False) as (store, artifacts):
        report = restore_backup(store, artifacts, folder)
    typer.echo(json.dumps(asdict(report)))


def scrub(state_dir: StateDir = None) -> None:
    """Compare all stored files with their hashes. The exit status is 1 if some are missing or differ."""
    with _opened("scrub", state_dir) as (store, artifacts):
        report = read_again(store, artifacts)
    typer.echo(json.dumps(asdict(report)))
    if report.missing or report.different:
        raise typer.Exit(1)


def erase(
    owner: Annotated[str, typer.Argument(help="Owner, as in `keys list`.")],
    yes: Annotated[bool, typer.Option("--yes", help="Skip the confirmation.")] = False,
    state_dir: StateDir = None,
) -> None:
    """Delete all data of one owner: keys, uploads, assets, jobs, products, webhooks. Backups stay unchanged."""
    if not yes:
        typer.confirm(f"Delete everything of owner {owner} for good?", abort=True)
    with _opened("erase", state_dir) as (store, artifacts):
        settings = settings_of(state_dir=state_dir)
        parts = open_parts(settings.resolved_artifacts_url, credentials=settings.s3_credentials)
        deleted = erase_owner(store, artifacts, parts, owner)
    typer.echo(json.dumps(deleted))


@contextmanager
def _opened(command: str, state_dir: Path | None, *, must_exist: bool = True) -> Iterator[tuple[Store, ArtifactStore]]:
    with one_line(command):
        settings = settings_of(state_dir=state_dir)
        if must_exist:
            _require_database(settings.resolved_database_url)
        with closing(Store.open(settings.resolved_database_url)) as store:
            yield store, open_artifacts(settings.resolved_artifacts_url, credentials=settings.s3_credentials)


def _require_database(url: str) -> None:
    """Refuse to create an empty SQLite database if the service's own is missing.

    Raises:
        SettingsError: the database file does not exist.
    """
    parts = make_url(url)
    if parts.get_backend_name() == "sqlite" and not Path(parts.database or "").is_file():
        advice = "name the service's folder by --state-dir or DYNAMICTREE_STATE_DIR"
        raise SettingsError(f"there is no database at {parts.database}; {advice}")
