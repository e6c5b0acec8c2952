"""Exceptions of the job store.

Each class that the API reports has a stable `code`, from which the service derives the status and problem type.
"""

from typing import ClassVar


class JobsError(Exception):
    """Base class of all exceptions of the job store."""

    code: ClassVar[str] = "jobs-error"


class NotFoundError(JobsError):
    """No such asset, job or artefact."""

    code = "not-found"


class GoneError(JobsError):
    """The asset, job or artefact has expired or was deleted."""

    code = "expired"


class ConflictError(JobsError):
    """The state of the resource forbids the operation."""

    code = "conflict"


class ReusedKeyError(JobsError):
    """The client's key was used for a request with another body."""

    code = "idempotency-key-reused"


class QuotaError(JobsError):
    """The owner has reached the limit of active jobs."""

    code = "too-many-active-jobs"


class BytesQuotaError(JobsError):
    """The owner has reached the limit of stored bytes."""

    code = "quota-exceeded"


class StorageAwayError(JobsError):
    """The byte storage does not respond, or refuses access."""

    code = "storage-unavailable"


class StorageFullError(JobsError):
    """The byte storage is full."""

    code = "disk-full"


class BackupError(JobsError):
    """A backup is damaged, or of a newer version."""


class SchemaError(JobsError):
    """The database has tables of an earlier revision."""


class FencedError(JobsError):
    """Another attempt owns the job, or it has ended; the caller must stop and publish nothing."""

    code = "fenced"


class OutboundError(JobsError):
    """An address is not allowed or does not respond."""

    code = "fetch-failed"


class SettingsError(JobsError):
    """The settings cannot be used."""
