"""Labels of clients, times to cancel at, processor time, and the bytes of intermediates by owner."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"

_ADDED: dict[str, tuple[tuple[str, sa.types.TypeEngine[Any], str | None], ...]] = {
    "jobs": (
        ("external_id", sa.String(128), None),
        ("metadata", sa.JSON(), "{}"),
        ("cancel_at", sa.Double(), None),
    ),
    "stage_cache": (("owner", sa.String(64), ""), ("bytes", sa.BigInteger(), "0")),
}


def upgrade() -> None:
    """Add the columns, and an index of uploads that were begun."""
    for table, columns in _ADDED.items():
        for name, kind, default in columns:
            op.add_column(table, sa.Column(name, kind, server_default=default, nullable=default is None))
    op.create_index("ix_uploads_state", "uploads", ["state"])
    op.create_index("ix_jobs_owner_external_id", "jobs", ["owner", "external_id"])


def downgrade() -> None:
    """Drop them."""
    op.drop_index("ix_jobs_owner_external_id", "jobs")
    op.drop_index("ix_uploads_state", "uploads")
    for table, columns in _ADDED.items():
        for name, _, _ in columns:
            op.drop_column(table, name)
