"""Keys and owners, resumable uploads, webhooks, logs of jobs, tombstones."""

import json

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

_ID = sa.String(length=64)


def upgrade() -> None:
    """Add the tables, and the columns that name an owner."""
    _owners()
    _uploads()
    _webhooks()
    _logs()


def _owners() -> None:
    op.create_table(
        "api_keys",
        sa.Column("id", _ID, nullable=False),
        sa.Column("owner", _ID, nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("digest", _ID, nullable=False),
        sa.Column("scopes", sa.JSON(), nullable=False),
        sa.Column("limits", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("expires_at", sa.Double(), nullable=True),
        sa.Column("revoked_at", sa.Double(), nullable=True),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("digest"),
    )
    op.create_index(op.f("ix_api_keys_owner"), "api_keys", ["owner"])
    op.add_column("assets", sa.Column("owner", _ID, server_default="", nullable=False))
    op.add_column("assets", sa.Column("bytes", sa.BigInteger(), server_default="0", nullable=False))
    op.create_index(op.f("ix_assets_owner"), "assets", ["owner"])
    op.add_column("jobs", sa.Column("owner", _ID, server_default="", nullable=False))
    op.add_column("jobs", sa.Column("priority", sa.String(length=16), server_default="normal", nullable=False))
    op.add_column("jobs", sa.Column("webhook_id", _ID, nullable=True))
    op.add_column("jobs", sa.Column("request_id", sa.String(length=128), nullable=True))
    op.add_column("jobs", sa.Column("traceparent", _ID, nullable=True))
    op.create_index("ix_jobs_owner_id", "jobs", ["owner", "id"])
    connection = op.get_bind()
    for row in connection.execute(sa.text("SELECT id, parts FROM assets")).all():
        parts = json.loads(row.parts) if isinstance(row.parts, str) else row.parts
        size = sum(part["bytes"] for part in parts)
        connection.execute(sa.text("UPDATE assets SET bytes = :size WHERE id = :id"), {"size": size, "id": row.id})


def _uploads() -> None:
    op.create_table(
        "uploads",
        sa.Column("id", _ID, nullable=False),
        sa.Column("owner", _ID, server_default="", nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("filename", sa.String(length=255), nullable=False),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("length", sa.BigInteger(), nullable=True),
        sa.Column("received", sa.BigInteger(), nullable=False),
        sa.Column("sha256", _ID, nullable=True),
        sa.Column("source_url", sa.Text(), nullable=True),
        sa.Column("make_asset", sa.Boolean(), nullable=False),
        sa.Column("writer", _ID, nullable=True),
        sa.Column("lease_until", sa.Double(), nullable=True),
        sa.Column("asset_id", _ID, nullable=True),
        sa.Column("error_code", _ID, nullable=True),
        sa.Column("error_message", sa.Text(), nullable=True),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("expires_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index(op.f("ix_uploads_expires_at"), "uploads", ["expires_at"])
    op.create_index(op.f("ix_uploads_owner"), "uploads", ["owner"])


def _webhooks() -> None:
    op.create_table(
        "webhook_endpoints",
        sa.Column("id", _ID, nullable=False),
        sa.Column("owner", _ID, server_default="", nullable=False),
        sa.Column("url", sa.Text(), nullable=False),
        sa.Column("events", sa.JSON(), nullable=False),
        sa.Column("secret", sa.String(length=128), nullable=False),
        sa.Column("old_secret", sa.String(length=128), nullable=True),
        sa.Column("old_secret_until", sa.Double(), nullable=True),
        sa.Column("disabled_reason", sa.String(length=255), nullable=True),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index(op.f("ix_webhook_endpoints_owner"), "webhook_endpoints", ["owner"])
    op.create_table(
        "deliveries",
        sa.Column("id", _ID, nullable=False),
        sa.Column("endpoint_id", _ID, nullable=False),
        sa.Column("job_id", _ID, nullable=False),
        sa.Column("event", sa.String(length=32), nullable=False),
        sa.Column("message_id", _ID, nullable=False),
        sa.Column("payload", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("log", sa.JSON(), nullable=False),
        sa.Column("next_at", sa.Double(), nullable=True),
        sa.Column("traceparent", _ID, nullable=True),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["endpoint_id"], ["webhook_endpoints.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index(op.f("ix_deliveries_created_at"), "deliveries", ["created_at"])
    op.create_index("ix_deliveries_endpoint_id_id", "deliveries", ["endpoint_id", "id"])
    op.create_index(op.f("ix_deliveries_next_at"), "deliveries", ["next_at"])


def _logs() -> None:
    op.create_table(
        "job_logs",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("job_id", _ID, nullable=False),
        sa.Column("at", sa.Double(), nullable=False),
        sa.Column("level", sa.String(length=16), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("fields", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(["job_id"], ["jobs.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index("ix_job_logs_job_id_id", "job_logs", ["job_id", "id"])
    op.create_table(
        "tombstones",
        sa.Column("id", _ID, nullable=False),
        sa.Column("owner", _ID, nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("gone_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
    )
    op.create_index(op.f("ix_tombstones_gone_at"), "tombstones", ["gone_at"])


def downgrade() -> None:
    """Drop the tables and the columns."""
    for name in ("tombstones", "job_logs", "deliveries", "webhook_endpoints", "uploads", "api_keys"):
        op.drop_table(name)
    op.drop_index("ix_jobs_owner_id", "jobs")
    op.drop_index(op.f("ix_assets_owner"), "assets")
    for name in ("owner", "priority", "webhook_id", "request_id", "traceparent"):
        op.drop_column("jobs", name)
    for name in ("owner", "bytes"):
        op.drop_column("assets", name)
