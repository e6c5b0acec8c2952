"""PostgreSQL connection with a timeout for servers that hang or are silently disconnected."""

from collections.abc import Generator
from typing import Any, TypeVar

import psycopg
from psycopg import errors

ANSWER_S = 30.0
"""Timeout of one statement [s]. Without it a request and its thread would wait forever."""

CONNECT_S = 5

Result = TypeVar("Result")


class TimeoutConnection(psycopg.Connection[tuple[Any, ...]]):
    """Connection that closes and raises OperationalError if a statement takes longer than `ANSWER_S`."""

    def wait(self, gen: Generator[Any, Any, Result], interval: float = 0.1, timeout: float | None = None) -> Result:
        """Run one exchange with the server, with a timeout."""
        try:
            return super().wait(gen, interval, ANSWER_S if timeout is None else timeout)
        except errors._WaitTimeout as error:
            self.pgconn.finish()  # a late answer must not be read as that of the next statement
            raise psycopg.OperationalError(f"PostgreSQL did not answer within {ANSWER_S:g} s") from error


def connect(_dialect: object, _record: object, args: list[Any], options: dict[str, Any]) -> TimeoutConnection:
    """Open a connection; SQLAlchemy's event `do_connect`."""
    return TimeoutConnection.connect(*args, **{"connect_timeout": CONNECT_S, **options})
