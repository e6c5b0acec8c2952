"""A connection to PostgreSQL that gives up on a server which does not answer: hung, or cut off without a word."""

from collections.abc import Generator
from typing import Any, TypeVar

import psycopg
from psycopg import errors

ANSWER_S = 30.0
"""Longest time for the answer to one statement. Without it a request, and its thread, would wait for ever."""

CONNECT_S = 5

Result = TypeVar("Result")


class ImpatientConnection(psycopg.Connection[tuple[Any, ...]]):
    """Is closed, and raises OperationalError, where the server takes longer than `ANSWER_S` over a statement."""

    def wait(self, gen: Generator[Any, Any, Result], interval: float = 0.1, timeout: float | None = None) -> Result:
        """Run one exchange with the server to its end."""
        try:
            return super().wait(gen, interval, ANSWER_S if timeout is None else timeout)
        except errors._WaitTimeout as error:
            self.pgconn.finish()  # an answer that comes later must not be taken for that of the next statement
            raise psycopg.OperationalError(f"PostgreSQL did not answer within {ANSWER_S:g} s") from error


def connect(_dialect: object, _record: object, args: list[Any], options: dict[str, Any]) -> ImpatientConnection:
    """Open a connection; SQLAlchemy's event `do_connect`."""
    return ImpatientConnection.connect(*args, **{"connect_timeout": CONNECT_S, **options})
