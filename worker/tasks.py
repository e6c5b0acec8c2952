"""The one Celery task. Errors are stored as (code, message) and never cross the queue."""

import logging
import os
import resource
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from celery import Task, signals
from celery.exceptions import SoftTimeLimitExceeded

from dynamictree.errors import Cancelled, CheckpointError, DynamicTreeError
from dynamictree.memory import return_freed_memory
from jobs.errors import FencedError, GoneError, NotFoundError, StorageAwayError, StorageFullError
from jobs.lifecycle.attempts import add_usage, claim, fail, finish_cancel, forgive_loss, release_attempt, succeed
from jobs.lifecycle.maintenance import RUN_JOB
from jobs.logging_setup import log_ids
from jobs.records import Claim
from jobs.settings import Settings, read_settings
from jobs.states import GPU
from jobs.storage.artifacts import is_full
from worker.app import app, stopping
from worker.attempt import run_stages
from worker.cancellation import HandedBack, Watch
from worker.half_done import half_done_folder
from worker.runtime import Runtime, close_runtime, runtime

logger = logging.getLogger(__name__)

CODED = (GoneError, StorageAwayError, StorageFullError)
"""Errors of the job store that explain why a job failed."""


class JobTask(Task):  # type: ignore[misc]
    """Task base class that records how a failed attempt ended."""

    throws = (Cancelled, FencedError, HandedBack, DynamicTreeError, *CODED)  # expected errors: logged without traceback

    def after_return(self, *_: object) -> None:
        """Return freed memory; Celery calls this in the task's process, however the task ended."""
        return_freed_memory()

    def on_failure(
        self, exc: BaseException, task_id: str, args: tuple[str, int], kwargs: dict[str, object], einfo: object
    ) -> None:
        """Record the failure; Celery calls this in the task's process."""
        resources = runtime()
        job_id, attempt = args
        with log_ids(job_id=job_id, attempt=attempt):
            try:
                claimed = Claim(job=replace(resources.store.job(job_id), attempt=attempt), owner=resources.owner)
                with log_ids(request_id=claimed.job.request_id):
                    end_attempt(resources, claimed, exc)
            except (FencedError, NotFoundError) as error:
                logger.info("the end of an attempt was not written: %s", error)


def end_attempt(resources: Runtime, claimed: Claim, error: BaseException) -> None:
    """Record how an exception ends the attempt.

    Raises:
        FencedError: another attempt owns the job.
    """
    store = resources.store
    match error:
        case FencedError():
            forgive_loss(store, claimed.job.id)
            raise error
        case Cancelled():
            finish_cancel(store, claimed)
        case HandedBack():
            release_attempt(store, claimed)
        case DynamicTreeError() | GoneError() | StorageAwayError() | StorageFullError():
            fail(store, claimed, code=error.code, message=str(error))
        case OSError() if is_full(error):
            fail(store, claimed, code=StorageFullError.code, message="the worker's disk is full; try again later")
        case MemoryError() | RuntimeError() if is_allocation_failure(error):
            fail(
                store, claimed, code="out-of-memory", message="the worker's memory did not suffice; simplify the input"
            )
        case SoftTimeLimitExceeded():
            allowed = f"{resources.settings.soft_time_limit_s} s are allowed"
            half_done = half_done_folder(resources.settings, claimed.job).is_dir()
            advice = "run it again: it goes on where it was" if half_done else "simplify the input"
            fail(store, claimed, code="time-limit", message=f"the job took too long; {allowed}; {advice}")
        case _:
            logger.error("job %s failed", claimed.job.id, exc_info=error)
            fail(store, claimed, code="internal-error", message="The cause was logged.")


@app.task(base=JobTask, name=RUN_JOB)  # type: ignore[untyped-decorator]
def run_job(job_id: str, attempt: int) -> None:
    """Run one attempt of a job, unless another worker runs it or has run it."""
    resources = runtime()
    resources.heartbeat.wait()
    claimed = claim(resources.store, job_id, attempt, owner=resources.owner, lease_s=resources.settings.lease_s)
    if claimed is None:
        logger.info("attempt %s of job %s is not to be run", attempt, job_id)
        return
    with log_ids(job_id=job_id, attempt=attempt, request_id=claimed.job.request_id):
        with metered(resources, claimed), Watch(resources, claimed, stopping=stopping.is_set) as watch:
            run_stages(resources, watch)
        state = succeed(resources.store, claimed)
        logger.info("job %s has %s", job_id, state)


@contextmanager
def metered(resources: Runtime, claimed: Claim) -> Iterator[None]:
    """Context manager that records the attempt's CPU time, with that of its child programs, and its GPU time."""
    began, processor_s = time.monotonic(), _processor_s()
    try:
        yield
    finally:
        on_gpu = resources.settings.worker_queue == GPU
        gpu_s = time.monotonic() - began if on_gpu else 0.0
        add_usage(resources.store, claimed, processor_s=_processor_s() - processor_s, gpu_s=gpu_s)


def _processor_s() -> float:
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in used)


@signals.worker_process_init.connect  # type: ignore[untyped-decorator]
def _on_start(**_: object) -> None:
    limit_memory(read_settings())
    runtime()
    threading.Thread(target=_warm_up, name="warm-up", daemon=True).start()


def _warm_up() -> None:
    """Animate a small tree, so that the first job does not wait for a library, model or kernel to load."""
    runtime().heartbeat.wait()  # report presence before the slow imports
    import worker.stages  # noqa: F401
    from dynamictree import method
    from dynamictree.warm_up import pole

    with suppress(CheckpointError):  # the job that needs the model reports the error
        list(method.animate(pole(), num_frames=1))
    logger.info("the default model is loaded")


@signals.worker_process_shutdown.connect  # type: ignore[untyped-decorator]
def _on_stop(**_: object) -> None:
    close_runtime(runtime())


def limit_memory(settings: Settings) -> int:
    """Limit this process's writable memory [bytes], and that of each program that it starts.

    An allocation beyond the limit raises MemoryError, which ends the job with `out-of-memory`.
    """
    share = 0.8  # the rest is for Celery's own process, the heartbeat and files in /tmp
    allowed = settings.job_memory_bytes or int(share * available_bytes())
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    allowed = allowed if hard == resource.RLIM_INFINITY else min(allowed, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (allowed, hard))
    return allowed


def available_bytes(cgroup: Path = Path("/sys/fs/cgroup")) -> int:
    """Return the memory of the machine, or of the container if that is less [bytes]."""
    available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for name in ("memory.max", "memory/memory.limit_in_bytes"):  # cgroup version 2, version 1
        path = cgroup / name
        if path.is_file() and (text := path.read_text().strip()).isdecimal():
            available = min(available, int(text))
    return available


def is_allocation_failure(error: BaseException) -> bool:
    """Return whether an allocation failed; PyTorch raises RuntimeError for it."""
    return isinstance(error, MemoryError) or "can't allocate memory" in str(error) or "out of memory" in str(error)
