"""The message that crosses the queue: job and attempt. Everything else is read from the store."""

from dataclasses import dataclass

RUN_JOB = "dynamictree.run_job"


@dataclass(frozen=True, kw_only=True)
class RunJob:
    """Ask a worker to run one attempt of a job."""

    job_id: str
    attempt: int
    queue: str

    @property
    def args(self) -> tuple[str, int]:
        """The task's arguments."""
        return (self.job_id, self.attempt)
