"""Engines for the job store: SQLite in WAL mode on one machine, PostgreSQL on many."""

import os
import re
import sqlite3
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import event
from sqlalchemy.engine import make_url

BUSY_TIMEOUT_S = 10.0


def open_engine(url: str) -> sa.Engine:
    """Create an engine whose transactions may write from their first statement on."""
    if make_url(url).get_backend_name() != "sqlite":
        from jobs.database.postgres_connection import connect  # imports psycopg, which SQLite does not need

        url = re.sub("^postgresql://", "postgresql+psycopg://", url)
        engine = sa.create_engine(url, pool_pre_ping=True, pool_size=10, max_overflow=30)
        event.listen(engine, "do_connect", connect)
        return engine
    database = make_url(url).database
    if database and database != ":memory:":
        Path(database).parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with suppress(OSError):  # SQLite reports the cause; closing an existing file drops this process's locks
            os.close(os.open(database, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600))
        with suppress(OSError):  # the file contains secrets of webhooks; SQLite gives its journal the same mode
            os.chmod(database, 0o600)
    engine = sa.create_engine(url, connect_args={"timeout": BUSY_TIMEOUT_S}, pool_size=60, max_overflow=0)
    event.listen(engine, "connect", _configure_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _configure_sqlite(connection: sqlite3.Connection, _record: object) -> None:
    connection.isolation_level = None  # `_begin_sqlite` begins transactions, never the driver
    _switch_to_wal(connection)
    connection.execute("PRAGMA synchronous=FULL")  # an accepted job survives a power cut
    connection.execute("PRAGMA foreign_keys=ON")


def _switch_to_wal(connection: sqlite3.Connection) -> None:
    # SQLite refuses this switch at once, without its busy timeout, while another connection is switching
    deadline = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
            return
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.01)


def _begin_sqlite(connection: sa.Connection) -> None:
    # IMMEDIATE: a transaction that reads first and then writes could get SQLITE_BUSY at once, without the timeout
    reading = connection.get_execution_options().get("reading", False)
    connection.exec_driver_sql("BEGIN" if reading else "BEGIN IMMEDIATE")


def upsert(
    connection: sa.Connection,
    table: sa.Table,
    values: Mapping[str, object],
    *,
    only_if: sa.ColumnElement[bool] | None = None,
) -> bool:
    """Insert a row, or update the one with its primary key if `only_if` holds; return whether a row was written."""
    keys = [column.name for column in table.primary_key.columns]
    changes = {name: value for name, value in values.items() if name not in keys}
    statement = (
        _insert(connection, table)
        .values(values)
        .on_conflict_do_update(index_elements=keys, set_=changes, where=only_if)
    )
    return _touched_a_row(connection, table, statement)


def insert_or_add(connection: sa.Connection, table: sa.Table, keys: Mapping[str, object], **amounts: float) -> None:
    """Insert a row, or add to the columns of the one with this primary key."""
    changes = {name: table.c[name] + amount for name, amount in amounts.items()}
    statement = _insert(connection, table).values({**keys, **amounts})
    connection.execute(statement.on_conflict_do_update(index_elements=list(keys), set_=changes))


def insert_new(connection: sa.Connection, table: sa.Table, values: Mapping[str, object], *, unique: str) -> bool:
    """Insert a row unless a unique column already has its value; return whether it was inserted."""
    statement = _insert(connection, table).values(values).on_conflict_do_nothing(index_elements=[unique])
    return _touched_a_row(connection, table, statement)


def _touched_a_row(connection: sa.Connection, table: sa.Table, statement: Any) -> bool:
    # rowcount is unreliable for an INSERT on PostgreSQL
    return connection.execute(statement.returning(*table.primary_key.columns)).one_or_none() is not None


def _insert(connection: sa.Connection, table: sa.Table) -> Any:
    # Both dialects have their own ON CONFLICT. Only the one in use is imported: both take 0.05 s.
    if connection.dialect.name == "postgresql":
        from sqlalchemy.dialects import postgresql

        return postgresql.insert(table)
    from sqlalchemy.dialects import sqlite

    return sqlite.insert(table)
