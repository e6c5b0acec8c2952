"""A job's log: one line per event, written in the event's transaction; without paths, hosts or secrets."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.records import Json

Level = Literal["info", "warning", "error"]


@dataclass(frozen=True, kw_only=True)
class LogLine:
    """One line; ids rise with time."""

    id: int
    at: float
    level: Level
    message: str
    fields: Mapping[str, Json]


def note(
    connection: sa.Connection, job_id: str, message: str, *, at: float, level: Level = "info", **fields: Json
) -> None:
    """Add a line to a job's log."""
    row = {"job_id": job_id, "at": at, "level": level, "message": message, "fields": fields}
    connection.execute(t.job_logs.insert().values(**row))


def lines(connection: sa.Connection, job_id: str, *, after: int, limit: int) -> list[LogLine]:
    """Lines after a given id, oldest first."""
    wanted = (t.job_logs.c.job_id == job_id) & (t.job_logs.c.id > after)
    query = sa.select(t.job_logs).where(wanted).order_by(t.job_logs.c.id).limit(limit)
    return [
        LogLine(id=row.id, at=row.at, level=row.level, message=row.message, fields=row.fields)
        for row in connection.execute(query)
    ]
