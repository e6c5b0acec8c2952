"""Touch a file from Celery's event loop, so that a health check need not start a Python of its own.

Registered by `worker.app`; off unless the setting `worker_alive_file` names a file.
"""

from celery import bootsteps
from celery.worker import WorkController

from jobs.settings import read_settings

TOUCH_S = 5.0


class Liveness(bootsteps.StartStopStep):  # type: ignore[misc]
    """Touch the file at the worker's start and every few seconds; remove it at the end."""

    requires = frozenset({"celery.worker.components:Timer"})

    def start(self, parent: WorkController) -> None:
        """Start the timer in the event loop that also receives messages."""
        self._path = read_settings().worker_alive_file
        if self._path is not None:
            self._path.touch()
            parent.timer.call_repeatedly(TOUCH_S, self._path.touch)

    def stop(self, parent: WorkController) -> None:
        """Remove the file."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
