"""Alembic's entry point: runs the revisions on the connection and in the transaction of `migrate`."""

from alembic import context

from jobs.database.tables import metadata

connection = context.config.attributes["connection"]
context.configure(connection=connection, target_metadata=metadata)
context.run_migrations()
