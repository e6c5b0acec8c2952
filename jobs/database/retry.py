"""Retry while the database is away: workers wait for it, requests do not."""

import logging
import time
from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, Protocol, TypeVar

import sqlalchemy as sa


class HasPatience(Protocol):
    """Object whose `patience_s` limits how long its methods wait for the database."""

    patience_s: float


P = ParamSpec("P")
T = TypeVar("T")
S = TypeVar("S", bound=HasPatience)

logger = logging.getLogger(__name__)

PAUSE_S = 0.5


def patient(ask: Callable[Concatenate[S, P], T]) -> Callable[Concatenate[S, P], T]:
    """Retry while the database restarts or its disk is full, for at most `patience_s`.

    Only for what may be done twice: an answer that was lost on the way back may have been a commit.
    """

    @wraps(ask)
    def waiting(store: S, /, *args: P.args, **options: P.kwargs) -> T:
        deadline = time.monotonic() + store.patience_s
        while True:
            try:
                return ask(store, *args, **options)
            except sa.exc.OperationalError as error:
                if time.monotonic() >= deadline:
                    raise
                logger.warning("the database is away; asked again in %g s: %s", PAUSE_S, error.orig)
                time.sleep(PAUSE_S)

    return waiting
