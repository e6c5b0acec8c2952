"""Make the tables of an empty job store; refuse those of an earlier revision."""

import sqlalchemy as sa

from jobs.database.tables import REVISION, metadata, schema_revision
from jobs.errors import SchemaError

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
