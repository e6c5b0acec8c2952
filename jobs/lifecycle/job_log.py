"""A job's log: one line per event, written in the event's transaction; without paths, hosts or secrets."""

from collections.abc import Sequence
from typing import Any, Literal

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.records import Json

Level = Literal["info", "warning", "error"]


def note(
    connection: sa.Connection, job_id: str, message: str, *, at: float, level: Level = "info", **fields: Json
) -> None:
    """Add a line to a job's log."""
    row = {"job_id": job_id, "at": at, "level": level, "message": message, "fields": fields}
    connection.execute(t.job_logs.insert().values(**row))


def lines(connection: sa.Connection, job_id: str, *, after: int, limit: int) -> Sequence[sa.Row[Any]]:
    """Rows of lines after a given id, oldest first; ids rise with time."""
    wanted = (t.job_logs.c.job_id == job_id) & (t.job_logs.c.id > after)
    return connection.execute(sa.select(t.job_logs).where(wanted).order_by(t.job_logs.c.id).limit(limit)).all()
