"""Revisions of the job store's tables, and how to get from one to the next (alembic)."""

from pathlib import Path
from typing import TYPE_CHECKING

import sqlalchemy as sa

from jobs.database.tables import HEAD

if TYPE_CHECKING:
    from alembic.config import Config

_LOCK = 7_305_112  # any fixed number: PostgreSQL's advisory lock while one process migrates


def migrate(engine: sa.Engine) -> None:
    """Bring the tables to `HEAD`. Safe to call from many processes at once; cheap where nothing is to be done."""
    with engine.begin() as connection:
        if _is_current(connection):
            return
        if engine.dialect.name == "postgresql":
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_LOCK)))
        if _is_current(connection):
            return
        # alembic takes 0.2 s to import, which a start with nothing to do should not pay
        from alembic import command

        command.upgrade(_config(connection), "head")


def step_back(engine: sa.Engine, revision: str) -> None:
    """Bring the tables back to a revision, `base` for none at all. What only later ones hold is lost."""
    from alembic import command

    with engine.begin() as connection:
        command.downgrade(_config(connection), revision)


def _config(connection: sa.Connection) -> "Config":
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent))
    config.attributes["connection"] = connection
    return config


def _is_current(connection: sa.Connection) -> bool:
    """Whether the tables are at `HEAD`, or at a later revision: a rolling update has old and new processes at once.

    Revisions only add (tables, and columns that are nullable or have a server default), so that old code goes on.
    """
    revision = _revision(connection)
    return revision is not None and revision >= HEAD


def _revision(connection: sa.Connection) -> str | None:
    if not sa.inspect(connection).has_table("alembic_version"):
        return None
    return connection.execute(sa.text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
