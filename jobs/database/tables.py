"""Tables of the job store, and how they are made. Times are seconds since 1970."""

import sqlalchemy as sa

from jobs.errors import SchemaError

REVISION = 2
"""Of these tables. A release that changes them raises it and adds only what old code can ignore."""

metadata = sa.MetaData()
_id = sa.String(64)
_hash = sa.String(64)

schema_revision = sa.Table("schema_revision", sa.MetaData(), sa.Column("number", sa.Integer, primary_key=True))
"""Of the database; not among the tables that are saved and restored."""

api_keys = sa.Table(
    "api_keys",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("owner", _id, nullable=False, index=True),
    sa.Column("name", sa.String(128), nullable=False),
    sa.Column("digest", _hash, nullable=False, unique=True),  # sha256 of the key, which is nowhere
    sa.Column("scopes", sa.JSON, nullable=False),
    sa.Column("limits", sa.JSON, nullable=False),  # what differs from the settings
    sa.Column("created_at", sa.Double, nullable=False),
    sa.Column("expires_at", sa.Double),
    sa.Column("revoked_at", sa.Double),
    sa.Column("last_used_at", sa.Double),  # written once an hour at most
)

assets = sa.Table(
    "assets",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("owner", _id, nullable=False, index=True),  # empty where no key was asked for
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("fingerprint", _hash, nullable=False),
    sa.Column("live_fingerprint", _hash, unique=True),  # null once deleted, so that the same bytes may come again
    sa.Column("parts", sa.JSON, nullable=False),
    sa.Column("prepared", sa.JSON),
    sa.Column("summary", sa.JSON, nullable=False),
    sa.Column("metadata", sa.JSON, nullable=False),  # the client's, returned as they are
    sa.Column("created_at", sa.Double, nullable=False),
    sa.Column("expires_at", sa.Double, nullable=False, index=True),
    sa.Column("deleted_at", sa.Double),
)

jobs = sa.Table(
    "jobs",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("owner", _id, nullable=False),
    sa.Column("type", sa.String(16), nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("asset_id", _id, sa.ForeignKey("assets.id"), nullable=False, index=True),
    sa.Column("preset", sa.String(64), nullable=False),
    sa.Column("seed", sa.BigInteger, nullable=False),
    sa.Column("params", sa.JSON, nullable=False),
    sa.Column("queue", sa.String(32), nullable=False),
    sa.Column("priority", sa.String(16), nullable=False),
    sa.Column("webhook_id", _id),
    sa.Column("webhook_events", sa.JSON),  # of this job, for that endpoint; null: those of its end
    sa.Column("request_id", sa.String(128)),  # of the request that made it
    sa.Column("traceparent", sa.String(64)),
    sa.Column("attempt", sa.Integer, nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("lease_owner", sa.String(128)),
    sa.Column("lease_until", sa.Double),
    sa.Column("lost_stages", sa.JSON, nullable=False),  # the stage that each lost attempt died in
    sa.Column("error_code", sa.String(64)),
    sa.Column("error_message", sa.Text),
    sa.Column("client_key", sa.String(160), unique=True),  # what the client named this request
    sa.Column("body_sha256", _hash),
    sa.Column("retry_of", _id),
    sa.Column("external_id", sa.String(128)),  # the client's own name for it
    sa.Column("metadata", sa.JSON, nullable=False),  # the client's, returned as they are
    sa.Column("cancel_at", sa.Double),
    sa.Column("destination", sa.Text),  # where its products are copied to
    sa.Column("processor_s", sa.Double, nullable=False),  # of all attempts
    sa.Column("gpu_s", sa.Double, nullable=False),
    sa.Column("created_at", sa.Double, nullable=False, index=True),
    sa.Column("started_at", sa.Double),
    sa.Column("finished_at", sa.Double, index=True),
    sa.Index("ix_jobs_state_lease", "state", "lease_until"),
    sa.Index("ix_jobs_owner_id", "owner", "id"),
    sa.Index("ix_jobs_owner_external_id", "owner", "external_id"),
)

stages = sa.Table(
    "stages",
    metadata,
    sa.Column("job_id", _id, sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("name", sa.String(16), primary_key=True),
    sa.Column("position", sa.Integer, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("progress", sa.Double, nullable=False),
    sa.Column("cached", sa.Boolean, nullable=False),
    sa.Column("started_at", sa.Double),
    sa.Column("finished_at", sa.Double),
)

artifacts = sa.Table(
    "artifacts",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("job_id", _id, sa.ForeignKey("jobs.id", ondelete="CASCADE"), nullable=False),
    sa.Column("stage", sa.String(16), nullable=False),
    sa.Column("name", sa.String(255), nullable=False),
    sa.Column("media_type", sa.String(128), nullable=False),
    sa.Column("sha256", _hash, nullable=False, index=True),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("created_at", sa.Double, nullable=False),
    sa.Column("expires_at", sa.Double, nullable=False, index=True),
    sa.Column("facts", sa.JSON, nullable=False, server_default="{}"),  # how far it is from the motion, by name
    sa.UniqueConstraint("job_id", "name"),
)

stage_cache = sa.Table(
    "stage_cache",
    metadata,
    sa.Column("key", _hash, primary_key=True),
    sa.Column("stage", sa.String(16), nullable=False),
    sa.Column("files", sa.JSON, nullable=False),
    sa.Column("used_at", sa.Double, nullable=False, index=True),
    sa.Column("owner", _id, nullable=False, server_default=""),
    sa.Column("bytes", sa.BigInteger, nullable=False, server_default="0"),  # of files that no job offers
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

uploads = sa.Table(
    "uploads",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("owner", _id, nullable=False, index=True),
    sa.Column("state", sa.String(16), nullable=False, index=True),
    sa.Column("filename", sa.String(255), nullable=False),
    sa.Column("options", sa.JSON, nullable=False),  # how to read it: kind, up_axis, unit_m
    sa.Column("length", sa.BigInteger),  # null while an address does not tell
    sa.Column("received", sa.BigInteger, nullable=False),
    sa.Column("sha256", _hash),  # as promised; as found once it is whole
    sa.Column("source_url", sa.Text),
    sa.Column("make_asset", sa.Boolean, nullable=False),  # without being asked for it
    sa.Column("writer", sa.String(64)),  # the request that may write
    sa.Column("lease_until", sa.Double),
    sa.Column("asset_id", _id),
    sa.Column("error_code", sa.String(64)),
    sa.Column("error_message", sa.Text),
    sa.Column("created_at", sa.Double, nullable=False),
    sa.Column("expires_at", sa.Double, nullable=False, index=True),
)

webhook_endpoints = sa.Table(
    "webhook_endpoints",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("owner", _id, nullable=False, index=True),
    sa.Column("url", sa.Text, nullable=False),
    sa.Column("events", sa.JSON, nullable=False),
    sa.Column("secret", sa.String(128), nullable=False),
    sa.Column("old_secret", sa.String(128)),  # signs too, until its time is over
    sa.Column("old_secret_until", sa.Double),
    sa.Column("disabled_reason", sa.String(255)),
    sa.Column("created_at", sa.Double, nullable=False),
)

deliveries = sa.Table(
    "deliveries",
    metadata,
    sa.Column("id", _id, primary_key=True),
    sa.Column("endpoint_id", _id, sa.ForeignKey("webhook_endpoints.id", ondelete="CASCADE"), nullable=False),
    sa.Column("job_id", _id, nullable=False),
    sa.Column("event", sa.String(32), nullable=False),
    sa.Column("message_id", _id, nullable=False),  # the same for a replay, so that the receiver may know it
    sa.Column("payload", sa.Text, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("log", sa.JSON, nullable=False),
    sa.Column("next_at", sa.Double, index=True),  # null once it is over
    sa.Column("traceparent", sa.String(64)),
    sa.Column("created_at", sa.Double, nullable=False, index=True),
    sa.Index("ix_deliveries_endpoint_id_id", "endpoint_id", "id"),
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
    sa.Column("month", sa.String(7), primary_key=True),  # 2026-11, UTC
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("processor_s", sa.Double, nullable=False),
    sa.Column("gpu_s", sa.Double, nullable=False),
)

_LOCK = 7_305_112  # any fixed number: PostgreSQL's advisory lock while one process makes the tables


def make_tables(engine: sa.Engine) -> None:
    """Make the tables where there are none. Safe to call from many processes at once.

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
