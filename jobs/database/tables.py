"""Tables, derived from the dataclasses of their rows: mapped classes would not be frozen. Times: seconds since 1970."""

from collections.abc import Callable
from dataclasses import is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import sqlalchemy as sa
from pydantic import TypeAdapter

from jobs import records
from jobs.errors import SchemaError
from jobs.states import JobState

REVISION = 2
"""Revision of these tables. A release that changes them raises it and adds only what old code can ignore."""

metadata = sa.MetaData()
_id = sa.String(64)
_hash = sa.String(64)
_SCALARS = {str: sa.String, int: sa.BigInteger, float: sa.Double, bool: sa.Boolean, JobState: sa.String}
_READERS: dict[type, dict[str, Callable[[Any], object] | None]] = {}
Record = TypeVar("Record")


def _columns_of(record: type, *, index: tuple[str, ...] = ()) -> list[sa.Column[Any]]:
    """Return a column per field of a record, nullable if the field is optional; `id` is the primary key."""
    columns: list[sa.Column[Any]] = []
    readers = _READERS[record] = {}
    for name, hint in get_type_hints(record).items():
        kind, *others = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        column_type = sa.String if get_origin(kind) is Literal else _SCALARS.get(kind, sa.JSON)
        has_null = NoneType in others
        columns.append(sa.Column(name, column_type, primary_key=name == "id", nullable=has_null, index=name in index))
        is_tuple = get_origin(kind) is tuple
        is_other = kind is JobState or is_dataclass(get_args(kind)[0] if is_tuple else kind)  # differs from the column
        readers[name] = TypeAdapter(hint).validate_python if is_other else tuple if is_tuple else None
    return [column for column in columns if column.name != "stages"]  # stages have their own table


def record_of(record: type[Record], row: sa.Row[Any], **more: object) -> Record:
    """Build the record of a row, with fields `more` from other tables; columns without a field are ignored."""
    readers = _READERS[record]
    columns = [(name, readers[name], value) for name, value in row._asdict().items() if name in readers]
    return record(**{name: value if read is None else read(value) for name, read, value in columns}, **more)


schema_revision = sa.Table("schema_revision", sa.MetaData(), sa.Column("number", sa.Integer, primary_key=True))
"""Revision of the database; this table is not backed up."""

api_keys = sa.Table(
    "api_keys", metadata, *_columns_of(records.KeyRecord, index=("owner",)), sa.UniqueConstraint("digest")
)

assets = sa.Table(
    "assets",
    metadata,
    *_columns_of(records.AssetRecord, index=("owner", "expires_at")),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("live_fingerprint", _hash, unique=True),  # null once deleted, so that the same bytes can come again
)

jobs = sa.Table(
    "jobs",
    metadata,
    *_columns_of(records.JobRecord, index=("asset_id", "created_at", "finished_at")),
    sa.Column("lease_owner", sa.String(128)),
    sa.Column("lease_until", sa.Double),
    sa.Column("lost_stages", sa.JSON, nullable=False),  # per lost attempt, the stage in which it died
    sa.Column("client_key", sa.String(160), unique=True),  # idempotency key of the request
    sa.Column("body_sha256", _hash),
    sa.ForeignKeyConstraint(["asset_id"], ["assets.id"]),
    sa.Index("ix_jobs_state_lease", "state", "lease_until"),
    sa.Index("ix_jobs_owner_id", "owner", "id"),
    sa.Index("ix_jobs_owner_external_id", "owner", "external_id"),
)

stages = sa.Table(
    "stages",
    metadata,
    sa.Column("job_id", _id, sa.ForeignKey("jobs.id", ondelete="CASCADE")),
    *_columns_of(records.StageRecord),
    sa.Column("position", sa.Integer, nullable=False),
    sa.PrimaryKeyConstraint("job_id", "name"),
)

artifacts = sa.Table(
    "artifacts",
    metadata,
    *_columns_of(records.ArtifactRecord, index=("sha256", "expires_at")),
    sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
    sa.UniqueConstraint("job_id", "name"),
)

uploads = sa.Table("uploads", metadata, *_columns_of(records.UploadRecord, index=("owner", "state", "expires_at")))

webhook_endpoints = sa.Table("webhook_endpoints", metadata, *_columns_of(records.Endpoint, index=("owner",)))

deliveries = sa.Table(
    "deliveries",
    metadata,
    *_columns_of(records.Delivery, index=("next_at", "created_at")),
    sa.ForeignKeyConstraint(["endpoint_id"], ["webhook_endpoints.id"], ondelete="CASCADE"),
    sa.Index("ix_deliveries_endpoint_id_id", "endpoint_id", "id"),
)

stage_cache = sa.Table(
    "stage_cache",
    metadata,
    sa.Column("key", _hash, primary_key=True),
    sa.Column("stage", sa.String(16), nullable=False),
    sa.Column("files", sa.JSON, nullable=False),
    sa.Column("used_at", sa.Double, nullable=False, index=True),
    sa.Column("owner", _id, nullable=False, server_default=""),
    sa.Column("bytes", sa.BigInteger, nullable=False, server_default="0"),  # size of files that no job offers
)

outbox = sa.Table(
    "outbox",
    metadata,
    sa.Column("job_id", _id, sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("attempt", sa.Integer, primary_key=True),
    sa.Column("created_at", sa.Double, nullable=False),
    sa.Column("sent_at", sa.Double, index=True),
)

blobs = sa.Table(
    "blobs",
    metadata,
    sa.Column("sha256", _hash, primary_key=True),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("touched_at", sa.Double, nullable=False, index=True),
)

leases = sa.Table(
    "leases",
    metadata,
    sa.Column("name", sa.String(128), primary_key=True),
    sa.Column("owner", sa.String(128), nullable=False),
    sa.Column("until", sa.Double, nullable=False),
)

tombstones = sa.Table(
    "tombstones",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("owner", _id, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("gone_at", sa.Double, nullable=False, index=True),
)

tallies = sa.Table(
    "tallies",
    metadata,
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("label", sa.String(64), primary_key=True),
    sa.Column("value", sa.Double, nullable=False),
)

usage = sa.Table(
    "usage",
    metadata,
    sa.Column("owner", _id, primary_key=True),
    sa.Column("month", sa.String(7), primary_key=True),  # such as 2026-11, in UTC
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("processor_s", sa.Double, nullable=False),
    sa.Column("gpu_s", sa.Double, nullable=False),
)

_LOCK = 7_305_112  # arbitrary key of the advisory lock in PostgreSQL while one process creates the tables


def make_tables(engine: sa.Engine) -> None:
    """Create the tables if there are none. Safe to call from many processes at once.

    Tables of a later revision are accepted: a rolling update has old and new processes at once, and revisions only add
    (tables, and columns that are nullable or have a server default).

    Raises:
        SchemaError: the tables are of an earlier revision.
    """
    with engine.begin() as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_LOCK)))
        names = set(sa.inspect(connection).get_table_names())
        if not names & metadata.tables.keys():
            metadata.create_all(connection)
            schema_revision.create(connection)
            connection.execute(schema_revision.insert().values(number=REVISION))
            return
        current = 0
        if schema_revision.name in names:
            current = connection.execute(sa.select(schema_revision.c.number)).scalar_one()
        if current < REVISION:
            raise SchemaError(
                f"the database has tables of revision {current}, this program needs {REVISION}; no release had the "
                "earlier ones, so start with an empty database or another state folder"
            )
