"""Counters since the store was created, for /metrics, each incremented exactly once, in the transaction it counts.

A counter has a name and a label, such as `jobs` and `succeeded`; `service/routes/metrics.py` exports them.
"""

import sqlalchemy as sa

from jobs.database import tables as t
from jobs.database.engine import insert_or_add

SECONDS = (0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0, 3600.0)
"""Upper bounds of the histogram buckets of durations [s]."""


def count(connection: sa.Connection, name: str, label: str = "", by: float = 1.0) -> None:
    """Increment a counter."""
    insert_or_add(connection, t.tallies, {"name": name, "label": label}, value=by)


def count_seconds(connection: sa.Connection, name: str, label: str, seconds: float) -> None:
    """Add a duration to its histogram bucket and to the sum."""
    bound = next((bound for bound in SECONDS if seconds <= bound), float("inf"))
    count(connection, f"{name}_bucket", f"{label}:{bound:g}")
    count(connection, f"{name}_sum", label, seconds)


def tallies(connection: sa.Connection) -> dict[str, dict[str, float]]:
    """Return all counters, by name and label."""
    totals: dict[str, dict[str, float]] = {}
    for row in connection.execute(sa.select(t.tallies)):
        totals.setdefault(row.name, {})[row.label] = row.value
    return totals
