"""The states of a job, and the stages that each type of job runs."""

from enum import StrEnum
from typing import Literal, get_args

from jobs.errors import ConflictError


class JobState(StrEnum):
    """States of a job. The last three are final."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELING = "canceling"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELED = "canceled"


TRANSITIONS: dict[JobState, frozenset[JobState]] = {
    JobState.QUEUED: frozenset({JobState.RUNNING, JobState.CANCELING}),
    JobState.RUNNING: frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELING}),
    JobState.CANCELING: frozenset({JobState.CANCELED}),
    JobState.SUCCEEDED: frozenset(),
    JobState.FAILED: frozenset(),
    JobState.CANCELED: frozenset(),
}
TERMINAL = frozenset(state for state, following in TRANSITIONS.items() if not following)
ACTIVE = frozenset(JobState) - TERMINAL

JobType = Literal["reconstruct", "voxelize", "diffuse", "animate"]
JOB_TYPES: tuple[JobType, ...] = get_args(JobType)
AssetKind = Literal["mesh", "photos", "cloud"]
ASSET_KINDS: tuple[AssetKind, ...] = get_args(AssetKind)
Priority = Literal["high", "normal", "low"]
StageState = Literal["queued", "running", "succeeded", "failed", "canceled"]


def stages_of(job_type: JobType, asset_kind: AssetKind) -> tuple[JobType, ...]:
    """Return the stages of a job in order: the requested one and those that it depends on.

    Photos and clouds are first reconstructed as a mesh.

    Raises:
        ConflictError: the job would reconstruct a mesh from a mesh.
    """
    if job_type == "reconstruct" and asset_kind == "mesh":
        raise ConflictError(
            "a reconstruct job needs an asset of photos or a cloud, this one is a mesh; ask for animate"
        )
    return JOB_TYPES[1 if asset_kind == "mesh" else 0 : JOB_TYPES.index(job_type) + 1]


AUTO, CPU, GPU = "auto", "cpu", "gpu"
"""Queues: chosen per job by its needs and the workers; for workers without a GPU; for workers with one."""


def queue_of(base: str, priority: Priority) -> str:
    """Return the queue of a priority: workers serve `cpu-high` before `cpu`, and `cpu` before `cpu-low`."""
    return base if priority == "normal" else f"{base}-{priority}"


def queues_of(base: str) -> tuple[str, ...]:
    """Return the queues that a worker of `base` serves, in order of priority."""
    return tuple(queue_of(base, priority) for priority in ("high", "normal", "low"))
