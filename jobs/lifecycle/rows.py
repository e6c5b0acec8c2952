"""Jobs within a transaction: conversion of rows to records, state transitions, and their events."""

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from ulid import ULID

from jobs.database import tables as t
from jobs.database.counters import count
from jobs.errors import NotFoundError, ReusedKeyError
from jobs.records import ENDS, ClientKey, JobRecord, StageRecord
from jobs.states import TRANSITIONS, JobState

_ID: sa.BindParameter[str] = sa.bindparam("id")
_JOB = sa.select(t.jobs).where(t.jobs.c.id == _ID)
_STAGES = sa.select(t.stages).where(t.stages.c.job_id == _ID).order_by(t.stages.c.position)
ARTIFACTS = sa.select(t.artifacts).where(t.artifacts.c.job_id == _ID).order_by(t.artifacts.c.id)


def change_state(connection: sa.Connection, job_id: str, target: JobState, **values: object) -> bool:
    """Change a job's state by compare-and-set; return False if its current state does not allow it."""
    before = [state for state, following in TRANSITIONS.items() if target in following]
    allowed = (t.jobs.c.id == job_id) & t.jobs.c.state.in_(before)
    change = t.jobs.update().where(allowed).values(state=target, version=t.jobs.c.version + 1, **values)
    return connection.execute(change).rowcount == 1


def delete_with_tombstones(connection: sa.Connection, which: sa.ColumnElement[bool], *, now: float) -> None:
    """Delete the chosen jobs and their dependent rows; store tombstones for their ids."""
    tombs = sa.select(t.jobs.c.id, t.jobs.c.owner, sa.literal("job"), sa.literal(now)).where(which)
    connection.execute(t.tombstones.insert().from_select(["id", "owner", "kind", "gone_at"], tombs))
    connection.execute(t.jobs.delete().where(which))


def end_job(
    connection: sa.Connection,
    job_id: str,
    target: JobState,
    *,
    now: float,
    error_code: str | None = None,
    error_message: str | None = None,
    **values: object,
) -> bool:
    """Move a job to a final state: release its lease, withdraw its message, close its stages."""
    values |= {"finished_at": now, "lease_owner": None, "lease_until": None}
    if not change_state(connection, job_id, target, error_code=error_code, error_message=error_message, **values):
        return False
    of_job = t.stages.c.job_id == job_id
    left = {"state": "failed" if target == JobState.FAILED else "canceled", "finished_at": now}
    connection.execute(t.stages.update().where(of_job & (t.stages.c.state == "running")).values(**left))
    connection.execute(t.stages.update().where(of_job & (t.stages.c.state == "queued")).values(state="canceled"))
    connection.execute(t.outbox.delete().where(t.outbox.c.job_id == job_id))
    queue_deliveries(connection, job_id, f"job.{target}", now=now)
    count(connection, "jobs", str(target))
    return True


def queue_deliveries(connection: sa.Connection, job_id: str, event: str, *, now: float) -> None:
    """Queue a delivery of an event of a job to every endpoint of its owner that subscribed to it."""
    job = connection.execute(sa.select(t.jobs).where(t.jobs.c.id == job_id)).one()
    wanted = (t.webhook_endpoints.c.owner == job.owner) & t.webhook_endpoints.c.disabled_reason.is_(None)
    of_job = ENDS if job.webhook_events is None else job.webhook_events
    payload = {
        "type": event,
        "timestamp": datetime.fromtimestamp(now, UTC).isoformat(),
        "data": {
            "id": job_id,
            "type": job.type,
            "state": job.state,
            "asset_id": job.asset_id,
            "retry_of": job.retry_of,
            "external_id": job.external_id,
            "metadata": job.metadata,
            "error_code": job.error_code,
            "url": f"/v1/jobs/{job_id}",
        },
    }
    for row in connection.execute(sa.select(t.webhook_endpoints).where(wanted)).all():
        if event in row.events or (row.id == job.webhook_id and event in of_job):
            row_values = {
                "id": str(ULID()),
                "endpoint_id": row.id,
                "job_id": job_id,
                "event": event,
                "message_id": f"msg_{ULID()}",
                "payload": json.dumps(payload, separators=(",", ":")),
                "state": "pending",
                "log": [],
                "next_at": now,
                "created_at": now,
            }
            connection.execute(t.deliveries.insert().values(**row_values))


def read_job(connection: sa.Connection, job_id: str) -> JobRecord:
    """Read one job with its stages within this transaction."""
    row = connection.execute(_JOB, {"id": job_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no job {job_id}")
    return job_of(row, connection.execute(_STAGES, {"id": job_id}).all())


def same_job(connection: sa.Connection, client_key: ClientKey) -> str:
    """Return the id of the job that was created with this client key.

    Raises:
        ReusedKeyError: that job's request had another body.
    """
    query = sa.select(t.jobs.c.id, t.jobs.c.body_sha256).where(t.jobs.c.client_key == client_key.key)
    row = connection.execute(query).one()
    if row.body_sha256 != client_key.body_sha256:
        raise ReusedKeyError(f"the same key was sent with another body before, for job {row.id}; use a new key")
    return str(row.id)


def job_of(row: sa.Row[Any], stages: Sequence[sa.Row[Any]]) -> JobRecord:
    """Build a job's record from its row and those of its stages."""
    return t.record_of(JobRecord, row, stages=tuple(t.record_of(StageRecord, stage) for stage in stages))
