"""Rows of webhook endpoints and of their deliveries."""

import base64
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import sqlalchemy as sa
from ulid import ULID

from jobs.database import tables as t
from jobs.errors import ConflictError, NotFoundError
from jobs.records import FIRST_ARTIFACT, Delivery, DeliveryState, Endpoint, Event, Try
from jobs.store import Store

MAX_ENDPOINTS = 20


# -- endpoints


def add_endpoint(store: Store, url: str, events: Sequence[Event]) -> Endpoint:
    """Store a new endpoint, with a new secret.

    Raises:
        ConflictError: the owner has too many endpoints.
    """
    new = Endpoint(
        id=str(ULID()),
        owner=store.owner or "",
        url=url,
        events=tuple(events),
        secret="whsec_" + base64.b64encode(secrets.token_bytes(24)).decode(),  # format of Standard Webhooks
        created_at=store.clock(),
    )
    with store.writing() as connection:
        mine = sa.select(sa.func.count()).where(t.webhook_endpoints.c.owner == new.owner)
        if connection.execute(mine).scalar_one() >= MAX_ENDPOINTS:
            raise ConflictError(f"there are {MAX_ENDPOINTS} webhook endpoints, which is the limit; delete one")
        connection.execute(t.webhook_endpoints.insert().values(**asdict(new)))
    return new


def endpoints(store: Store) -> list[Endpoint]:
    """Return all endpoints, oldest first."""
    with store.reading() as connection:
        query = sa.select(t.webhook_endpoints).where(store.owned(t.webhook_endpoints))
        return [t.record_of(Endpoint, row) for row in connection.execute(query.order_by(t.webhook_endpoints.c.id))]


def endpoint(store: Store, endpoint_id: str) -> Endpoint:
    """Return one endpoint."""
    this = (t.webhook_endpoints.c.id == endpoint_id) & store.owned(t.webhook_endpoints)
    with store.reading() as connection:
        row = connection.execute(sa.select(t.webhook_endpoints).where(this)).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no webhook endpoint {endpoint_id}")
    return t.record_of(Endpoint, row)


def delete_endpoint(store: Store, endpoint_id: str) -> None:
    """Delete an endpoint and its deliveries."""
    endpoint(store, endpoint_id)
    with store.writing() as connection:
        connection.execute(t.webhook_endpoints.delete().where(t.webhook_endpoints.c.id == endpoint_id))


# -- deliveries


def deliveries(store: Store, endpoint_id: str, *, before: str | None, limit: int) -> list[Delivery]:
    """Return deliveries to an endpoint, newest first."""
    endpoint(store, endpoint_id)
    query = sa.select(t.deliveries).where(t.deliveries.c.endpoint_id == endpoint_id)
    if before is not None:
        query = query.where(t.deliveries.c.id < before)
    with store.reading() as connection:
        return [
            t.record_of(Delivery, row)
            for row in connection.execute(query.order_by(t.deliveries.c.id.desc()).limit(limit))
        ]


def claim_due(
    store: Store, *, lease_s: float, limit: int, per_owner: int, busy: Mapping[str, int]
) -> list[tuple[Delivery, Endpoint]]:
    """Claim due deliveries, each for `lease_s`: at most `per_owner` per owner, including those that are `busy`.

    Events of one job reach an endpoint in order: its end waits until `job.first-artifact` was delivered or given up.
    """
    now = store.clock()
    owner = t.webhook_endpoints.c.owner
    place = sa.func.row_number().over(partition_by=owner, order_by=t.deliveries.c.next_at).label("place")
    earlier = t.deliveries.alias()
    of_same_job = (earlier.c.endpoint_id == t.deliveries.c.endpoint_id) & (earlier.c.job_id == t.deliveries.c.job_id)
    is_first = earlier.c.event == FIRST_ARTIFACT
    is_behind = sa.exists().where(of_same_job & is_first & earlier.c.next_at.is_not(None))
    due = (
        sa.select(t.deliveries.c.id, t.deliveries.c.next_at, owner, place)
        .join(t.webhook_endpoints, t.webhook_endpoints.c.id == t.deliveries.c.endpoint_id)
        .where((t.deliveries.c.next_at <= now) & ((t.deliveries.c.event == FIRST_ARTIFACT) | ~is_behind))
        .subquery()
    )
    with store.reading() as connection:
        rows = connection.execute(sa.select(due).where(due.c.place <= per_owner)).all()
    turns = {row.id: row.place + busy.get(row.owner, 0) for row in rows}
    eligible = [row for row in rows if turns[row.id] <= per_owner]
    eligible = sorted(eligible, key=lambda row: (turns[row.id], row.next_at))[:limit]
    if not eligible:
        return []
    claimed = []
    with store.writing() as connection:
        for row in eligible:
            this = (t.deliveries.c.id == row.id) & (t.deliveries.c.next_at == row.next_at)
            change = t.deliveries.update().where(this).values(next_at=now + lease_s).returning(*t.deliveries.c)
            delivery = connection.execute(change).one_or_none()
            if delivery is not None:
                to = connection.execute(sa.select(t.webhook_endpoints).filter_by(id=delivery.endpoint_id)).one()
                claimed.append((t.record_of(Delivery, delivery), t.record_of(Endpoint, to)))
    return claimed


def record_attempt(store: Store, delivery: Delivery, new: Try, *, retry_s: Sequence[float]) -> DeliveryState:
    """Record the result of an attempt and the next due time. Status 410 disables the endpoint."""
    log = [*(asdict(earlier) for earlier in delivery.log), asdict(new)]
    delivered = new.status is not None and 200 <= new.status < 300
    over = delivered or new.status == 410 or len(log) >= len(retry_s)
    state: DeliveryState = "delivered" if delivered else "failed" if over else "pending"
    next_at = None if over else new.at + retry_s[len(log)]
    with store.writing() as connection:
        this = t.deliveries.c.id == delivery.id
        connection.execute(t.deliveries.update().where(this).values(state=state, log=log, next_at=next_at))
        if new.status == 410:
            whom = t.webhook_endpoints.c.id == delivery.endpoint_id
            reason = {"disabled_reason": "the address answered 410 Gone"}
            connection.execute(t.webhook_endpoints.update().where(whom).values(**reason))
    return state
