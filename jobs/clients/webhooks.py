"""Rows of webhook endpoints and of their deliveries."""

import base64
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

import sqlalchemy as sa
from ulid import ULID

from jobs.clients.webhook_events import FIRST_ARTIFACT, DeliveryState, Event
from jobs.database import tables as t
from jobs.database.secret_box import SecretBox
from jobs.errors import ConflictError, NotFoundError
from jobs.store import Store

MAX_ENDPOINTS = 20
ROTATION_OVERLAP_S = 86400.0
"""So long an old secret signs beside the new one."""


@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """A receiver of events."""

    id: str
    owner: str
    url: str
    events: tuple[Event, ...]  # of every job; none: only of jobs that name this endpoint
    secret: str = field(repr=False)  # as stored: encrypted where there is a key for it
    old_secret: str | None = field(default=None, repr=False)
    old_secret_until: float | None = None
    disabled_reason: str | None = None
    created_at: float

    def signing_secrets(self, now: float, box: SecretBox) -> tuple[str, ...]:
        """The secrets that sign at a time, the newest first.

        Raises:
            SecretKeyError: the box has not the key that they were encrypted with.
        """
        stored = [self.secret]
        if self.old_secret is not None and self.old_secret_until is not None and self.old_secret_until > now:
            stored.append(self.old_secret)
        return tuple(box.decrypt(secret, self.id) for secret in stored)


@dataclass(frozen=True, kw_only=True)
class Try:
    """One delivery attempt."""

    at: float
    status: int | None  # none where no answer came
    detail: str
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """One message for one endpoint."""

    id: str
    endpoint_id: str
    job_id: str
    event: Event
    message_id: str
    payload: str
    state: DeliveryState
    log: tuple[Try, ...]
    next_at: float | None
    traceparent: str | None
    created_at: float


def new_secret() -> str:
    """A random signing secret, as Standard Webhooks writes it."""
    return "whsec_" + base64.b64encode(secrets.token_bytes(24)).decode()


# -- endpoints


def add_endpoint(store: Store, url: str, events: Sequence[Event], box: SecretBox) -> tuple[Endpoint, str]:
    """Store a new endpoint; return it and its new secret.

    Raises:
        ConflictError: there are too many.
    """
    secret, endpoint_id = new_secret(), str(ULID())
    new = Endpoint(
        id=endpoint_id,
        owner=store.owner or "",
        url=url,
        events=tuple(events),
        secret=box.encrypt(secret, endpoint_id),
        created_at=store.clock(),
    )
    with store.writing() as connection:
        mine = sa.select(sa.func.count()).where(t.webhook_endpoints.c.owner == new.owner)
        if connection.execute(mine).scalar_one() >= MAX_ENDPOINTS:
            raise ConflictError(f"there are {MAX_ENDPOINTS} webhook endpoints, which is the limit; delete one")
        connection.execute(t.webhook_endpoints.insert().values(**asdict(new)))
    return new, secret


def endpoints(store: Store) -> list[Endpoint]:
    """The endpoints, oldest first."""
    with store.reading() as connection:
        query = sa.select(t.webhook_endpoints).where(store.mine(t.webhook_endpoints)).order_by(t.webhook_endpoints.c.id)
        return [_endpoint(row) for row in connection.execute(query)]


def endpoint(store: Store, endpoint_id: str) -> Endpoint:
    """One endpoint.

    Raises:
        NotFoundError: there is none.
    """
    with store.reading() as connection:
        return _read_endpoint(connection, store, endpoint_id)


def rotate_secret(store: Store, endpoint_id: str, box: SecretBox) -> tuple[Endpoint, str]:
    """Give an endpoint a new secret, and return both; the old one signs too for `ROTATION_OVERLAP_S`.

    Raises:
        NotFoundError: there is none.
    """
    secret = new_secret()
    with store.writing() as connection:
        old = _read_endpoint(connection, store, endpoint_id)
        values = {"secret": box.encrypt(secret, endpoint_id), "old_secret": old.secret}
        until = store.clock() + ROTATION_OVERLAP_S
        this = t.webhook_endpoints.c.id == endpoint_id
        connection.execute(t.webhook_endpoints.update().where(this).values(**values, old_secret_until=until))
        return _read_endpoint(connection, store, endpoint_id), secret


def delete_endpoint(store: Store, endpoint_id: str) -> None:
    """Delete an endpoint and its deliveries.

    Raises:
        NotFoundError: there is none.
    """
    with store.writing() as connection:
        _read_endpoint(connection, store, endpoint_id)
        connection.execute(t.webhook_endpoints.delete().where(t.webhook_endpoints.c.id == endpoint_id))


def _read_endpoint(connection: sa.Connection, store: Store, endpoint_id: str) -> Endpoint:
    this = (t.webhook_endpoints.c.id == endpoint_id) & store.mine(t.webhook_endpoints)
    row = connection.execute(sa.select(t.webhook_endpoints).where(this)).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no webhook endpoint {endpoint_id}")
    return _endpoint(row)


def _endpoint(row: sa.Row[tuple[object, ...]]) -> Endpoint:
    values: dict[str, object] = dict(row._mapping)
    return Endpoint(**values | {"events": tuple(values["events"])})  # type: ignore[arg-type]


# -- deliveries


def deliveries(store: Store, endpoint_id: str, *, before: str | None, limit: int) -> list[Delivery]:
    """Deliveries to an endpoint, newest first.

    Raises:
        NotFoundError: there is no such endpoint.
    """
    endpoint(store, endpoint_id)
    query = sa.select(t.deliveries).where(t.deliveries.c.endpoint_id == endpoint_id)
    if before is not None:
        query = query.where(t.deliveries.c.id < before)
    with store.reading() as connection:
        return [_delivery(row) for row in connection.execute(query.order_by(t.deliveries.c.id.desc()).limit(limit))]


def replay(store: Store, endpoint_id: str, delivery_id: str) -> Delivery:
    """Queue a new delivery of the same message.

    Raises:
        NotFoundError: there is no such endpoint or delivery.
    """
    now = store.clock()
    with store.writing() as connection:
        _read_endpoint(connection, store, endpoint_id)
        this = (t.deliveries.c.id == delivery_id) & (t.deliveries.c.endpoint_id == endpoint_id)
        row = connection.execute(sa.select(t.deliveries).where(this)).one_or_none()
        if row is None:
            raise NotFoundError(f"there is no delivery {delivery_id} to endpoint {endpoint_id}")
        anew = {"id": str(ULID()), "state": "pending", "log": [], "next_at": now, "created_at": now}
        connection.execute(t.deliveries.insert().values(**dict(row._mapping) | anew))
        return _delivery(connection.execute(sa.select(t.deliveries).where(t.deliveries.c.id == anew["id"])).one())


def claim_due(
    store: Store, *, lease_s: float, limit: int, per_owner: int, busy: Mapping[str, int]
) -> list[tuple[Delivery, Endpoint]]:
    """Claim deliveries that are due, each for `lease_s`; of one owner at most `per_owner`, `busy` ones included.

    Events of one job reach an endpoint in order: its end waits until the first artifact was delivered, or given up.
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
            if connection.execute(t.deliveries.update().where(this).values(next_at=now + lease_s)).rowcount:
                delivery_row = connection.execute(sa.select(t.deliveries).where(t.deliveries.c.id == row.id)).one()
                whom = t.webhook_endpoints.c.id == delivery_row.endpoint_id
                to = connection.execute(sa.select(t.webhook_endpoints).where(whom)).one()
                claimed.append((_delivery(delivery_row), _endpoint(to)))
    return claimed


def record_try(store: Store, delivery: Delivery, new: Try, *, retry_s: Sequence[float]) -> DeliveryState:
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


def _delivery(row: sa.Row[tuple[object, ...]]) -> Delivery:
    log = tuple(Try(**new) for new in row._mapping["log"])
    return Delivery(**dict(row._mapping) | {"log": log})
