"""Retry while the database is unavailable: workers wait for it, requests do not."""

import logging
import time
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import sqlalchemy as sa

P = ParamSpec("P")
T = TypeVar("T")

logger = logging.getLogger(__name__)

RETRY_PAUSE_S = 0.5


def retry_while_unavailable(ask: Callable[P, T]) -> Callable[P, T]:
    """Retry while the database restarts or its disk is full, for at most `patience_s` of the first argument, a store.

    Only for idempotent functions: a statement whose answer was lost may have been committed.
    """

    @wraps(ask)
    def waiting(*args: P.args, **options: P.kwargs) -> T:
        deadline = time.monotonic() + args[0].patience_s  # type: ignore[attr-defined]
        while True:
            try:
                return ask(*args, **options)
            except sa.exc.OperationalError as error:
                if time.monotonic() >= deadline:
                    raise
                logger.warning("the database is away; asked again in %g s: %s", RETRY_PAUSE_S, error.orig)
                time.sleep(RETRY_PAUSE_S)

    return waiting
