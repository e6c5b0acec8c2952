"""End a worker that takes no messages although the queue has some.

Kombu may stop consuming without a word after a reconnection (kombu#2492, celery#10502) while the process answers pings;
what started the worker then starts it again.
"""

import logging
import os
import signal
import threading
import time

import redis
from celery import signals
from celery.worker import state

from jobs.settings import Settings, read_settings
from jobs.states import queues_of

logger = logging.getLogger(__name__)

LOOK_S = 5.0
REDIS_TIMEOUT_S = 5.0


def idle_since(since: float | None, *, waiting: int, busy: bool, now: float) -> float | None:
    """Since when messages wait for an idle worker; None while it works or none waits."""
    if busy or waiting == 0:
        return None
    return now if since is None else since


def watch(settings: Settings, stopped: threading.Event) -> None:
    """Check every few seconds until stopped; end this process and its forks if it is idle for too long."""
    queues = queues_of(settings.worker_queue)
    since: float | None = None
    client = redis.Redis.from_url(
        settings.resolved_redis_url, socket_timeout=REDIS_TIMEOUT_S, socket_connect_timeout=REDIS_TIMEOUT_S
    )
    while not stopped.wait(min(LOOK_S, settings.idle_limit_s / 4)):
        try:
            waiting = sum(int(client.llen(queue)) for queue in queues)
        except redis.RedisError:
            waiting = 0  # a queue that is away is not our fault
        now = time.monotonic()
        since = idle_since(since, waiting=waiting, busy=bool(state.reserved_requests), now=now)
        if since is not None and now - since >= settings.idle_limit_s:
            detail = f"{waiting} messages wait in {settings.worker_queue!r}, none taken for {settings.idle_limit_s:g} s"
            logger.critical("%s; this worker ends, to be started again", detail)
            os.kill(os.getpid(), signal.SIGQUIT)  # Celery's cold shutdown
            if not stopped.wait(settings.shutdown_grace_s):
                os._exit(1)


_stopped = threading.Event()


@signals.worker_ready.connect  # type: ignore[untyped-decorator]
def _begin(**_: object) -> None:
    threading.Thread(target=watch, args=(read_settings(), _stopped), name="watchdog", daemon=True).start()


@signals.worker_shutdown.connect  # type: ignore[untyped-decorator]
def _end(**_: object) -> None:
    _stopped.set()
