"""Exceptions of the job store.

Each class that the API answers with has a stable `code`, by which the service chooses status and problem type.
"""

from typing import ClassVar


class JobsError(Exception):
    """Root of all others."""

    code: ClassVar[str] = "jobs-error"


class NotFoundError(JobsError):
    """No such asset, job or artefact."""

    code = "not-found"


class GoneError(JobsError):
    """There was one; it expired or was deleted."""

    code = "expired"


class ConflictError(JobsError):
    """The state of the thing forbids it."""

    code = "conflict"


class ReusedKeyError(JobsError):
    """The client's key was used for a request with another body."""

    code = "idempotency-key-reused"


class QuotaError(JobsError):
    """The owner has as many jobs as are allowed."""

    code = "too-many-active-jobs"


class BytesQuotaError(JobsError):
    """The owner has as many bytes as are allowed."""

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
    """Another attempt owns the job, or it has ended; whoever gets this must stop and publish nothing."""

    code = "fenced"


class OutboundError(JobsError):
    """An address that may not be called, or that does not answer."""

    code = "fetch-failed"


class SettingsError(JobsError):
    """The settings cannot be used."""
