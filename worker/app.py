"""The Celery application. Messages carry only (job_id, attempt); all state is in the store.

Started with `celery -A worker.app worker`.
"""

import multiprocessing

from celery import Celery, bootsteps, signals
from celery.worker import WorkController

from jobs.logging_setup import set_up_logging
from jobs.settings import Settings, read_settings

stopping = multiprocessing.Event()
"""Set in every process of this worker when it was asked to stop; created before the pool forks."""

TOUCH_INTERVAL_S = 5.0


class Liveness(bootsteps.StartStopStep):  # type: ignore[misc]
    """Touch the setting `worker_alive_file` every few seconds, so that a health check does not have to start Python."""

    requires = frozenset({"celery.worker.components:Timer"})

    def start(self, parent: WorkController) -> None:
        """Start the timer in the event loop that also receives messages."""
        self._path = read_settings().worker_alive_file
        if self._path is not None:
            self._path.touch()
            self._touching = parent.timer.call_repeatedly(TOUCH_INTERVAL_S, self._path.touch)

    def stop(self, parent: WorkController) -> None:
        """Delete the file."""
        if self._path is not None:
            self._touching.cancel()
            self._path.unlink(missing_ok=True)


def make_app(settings: Settings) -> Celery:
    """Build the application. docs/decisions/service.md gives the reason for each setting."""
    app = Celery("dynamictree", broker=settings.broker_url, include=["worker.tasks"])
    app.conf.update(
        task_ignore_result=True,
        task_acks_late=True,
        worker_prefetch_multiplier=1,
        task_reject_on_worker_lost=False,
        task_acks_on_failure_or_timeout=True,
        task_soft_time_limit=settings.soft_time_limit_s,
        task_time_limit=settings.time_limit_s,
        task_default_queue=settings.worker_queue,
        task_store_errors_even_if_ignored=False,
        broker_transport_options={
            "visibility_timeout": settings.visibility_timeout_s,
            "unacked_restore_interval": settings.restore_interval_s,
            "unacked_restore_throttle": 1,
            "socket_keepalive": True,
            "queue_order_strategy": "priority",  # order of the queues in -Q: high, normal, low
            "health_check_interval": 30,
        },
        broker_connection_retry_on_startup=True,
        broker_connection_max_retries=None,
        worker_cancel_long_running_tasks_on_connection_loss=False,
        worker_proc_alive_timeout=60,
        worker_max_tasks_per_child=settings.worker_tasks_per_child,
        worker_max_memory_per_child=settings.worker_memory_kib,
        worker_hijack_root_logger=False,
        worker_redirect_stdouts=False,
        worker_send_task_events=False,
        accept_content=["json"],
        task_serializer="json",
    )
    app.steps["worker"].add(Liveness)
    return app


app = make_app(read_settings())


@signals.setup_logging.connect  # type: ignore[untyped-decorator]
def _set_up_logging(**_: object) -> None:
    set_up_logging(read_settings())


@signals.worker_shutting_down.connect  # type: ignore[untyped-decorator]
def _tell_children(**_: object) -> None:
    stopping.set()
