"""Webhook messages: written in the transaction that they tell of, one for every endpoint that subscribed."""

import json
from datetime import UTC, datetime
from typing import Literal, get_args

import sqlalchemy as sa
from ulid import ULID

from jobs.database import tables as t

Event = Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]
EVENTS: tuple[Event, ...] = get_args(Event)
FIRST_ARTIFACT: Event = "job.first-artifact"
ENDS: tuple[Event, ...] = EVENTS[1:]
DeliveryState = Literal["pending", "delivered", "failed"]


def announce(connection: sa.Connection, job_id: str, event: str, *, now: float) -> None:
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
                "traceparent": job.traceparent,
                "created_at": now,
            }
            connection.execute(t.deliveries.insert().values(**row_values))
