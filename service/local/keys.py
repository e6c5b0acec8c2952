"""`dynamictree keys`: create, list and revoke API keys, in the store that the settings name."""

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Annotated

import typer

from jobs.clients.keys import create_key, revoke_key
from jobs.clients.keys import keys as all_keys
from jobs.records import LIMITS, SCOPES, Limit, Scope
from jobs.store import Store
from service.local.command_line import StateDir, one_line, settings_of

app = typer.Typer(no_args_is_help=True, help="Create, list and revoke API keys.")


@app.command()
def create(
    name: Annotated[str, typer.Argument(help="Name of the key.")],
    owner: Annotated[str | None, typer.Option(help="Owner; all keys of an owner access the same data.")] = None,
    scope: Annotated[list[str] | None, typer.Option(help=f"Scope: {', '.join(SCOPES)}; by default all.")] = None,
    limit: Annotated[
        list[str] | None, typer.Option(help=f"NAME=NUMBER, instead of the setting: {', '.join(LIMITS)}.")
    ] = None,
    expires_days: Annotated[float | None, typer.Option(help="Days until it expires; by default never.", min=0)] = None,
    state_dir: StateDir = None,
) -> None:
    """Create a key. It is printed once and not stored."""
    scopes = _scopes(scope or list(SCOPES))
    limits = _limits(limit or [])
    with _store(state_dir) as store:
        expires_s = None if expires_days is None else expires_days * 86400
        record, key = create_key(store, name=name, owner=owner, scopes=scopes, limits=limits, expires_s=expires_s)
    typer.echo(key)
    typer.echo(f"key {record.id} of owner {record.owner}; keep it, it is not shown again", err=True)


@app.command("list")
def list_keys(state_dir: StateDir = None) -> None:
    """List the keys' ids, owners, scopes, expiry and last use (to the hour); the keys themselves are not stored."""
    with _store(state_dir) as store:
        records = all_keys(store)
    for key in records:
        state = "valid" if key.valid(time.time()) else "revoked" if key.revoked_at is not None else "expired"
        used = "never used" if key.last_used_at is None else f"used {_time(key.last_used_at)}"
        ends = "" if key.expires_at is None else f", until {_time(key.expires_at)}"
        typer.echo(f"{key.id}  {state:8} {key.owner:26}  {','.join(key.scopes)}  {key.name}  {used}{ends}")


@app.command()
def revoke(key_id: Annotated[str, typer.Argument(help="Id from `keys list`.")], state_dir: StateDir = None) -> None:
    """Revoke a key; it stops working within two seconds."""
    with _store(state_dir) as store:
        revoke_key(store, key_id)


def _time(seconds: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M", time.gmtime(seconds))


def _scopes(given: list[str]) -> tuple[Scope, ...]:
    unknown = [scope for scope in given if scope not in SCOPES]
    if unknown:
        raise typer.BadParameter(f"there is no scope {unknown[0]!r}; there are {', '.join(SCOPES)}")
    return tuple(scope for scope in SCOPES if scope in given)


def _limits(given: list[str]) -> dict[Limit, int]:
    limits = {}
    for text in given:
        name, _, number = text.partition("=")
        records = [limit for limit in LIMITS if limit == name]
        if not records or not number.isdecimal() or int(number) < 1:
            raise typer.BadParameter(f"{text!r} is no limit; write NAME=NUMBER with one of {', '.join(LIMITS)}")
        limits[records[0]] = int(number)
    return limits


@contextmanager
def _store(state_dir: Path | None) -> Iterator[Store]:
    with one_line("keys"), closing(Store.open(settings_of(state_dir=state_dir).resolved_database_url)) as store:
        yield store
