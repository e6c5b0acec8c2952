"""Rows of the store as dataclasses, from which the tables are derived (`jobs/database/tables.py`).

Times are seconds since 1970. An `owner` is empty if no key was required.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from jobs.states import TERMINAL, AssetKind, JobState, JobType, Priority, StageState

Json = None | bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"]
"""Value of a JSON column."""
Facts = Mapping[str, int | float | list[str]]  # facts about a file, by name


@dataclass(frozen=True, kw_only=True)
class AssetPart:
    """One file of an asset: the mesh, an MTL or texture beside it, or one photo."""

    name: str
    sha256: str
    bytes: int


@dataclass(frozen=True, kw_only=True)
class AssetRecord:
    """A checked upload."""

    id: str
    owner: str = ""
    kind: AssetKind
    fingerprint: str  # sha256 of everything that determines the asset
    parts: tuple[AssetPart, ...]  # the mesh first; photos in the order sent
    prepared: AssetPart | None  # the mesh in metres and +Z up, written by the parser's process; None for photos
    summary: Mapping[str, Json]
    metadata: Mapping[str, str] = field(default_factory=dict)
    created_at: float
    expires_at: float
    deleted_at: float | None = None

    @property
    def bytes(self) -> int:
        """Return the size of all files, including the prepared one [bytes]."""
        return sum(part.bytes for part in (*self.parts, *([self.prepared] if self.prepared else [])))


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """One stage of one job."""

    name: JobType
    state: StageState = "queued"
    progress: float = 0.0  # share in [0, 1]
    cached: bool = False
    started_at: float | None = None
    finished_at: float | None = None


@dataclass(frozen=True, kw_only=True)
class JobRecord:
    """One job. Every change increments `version`, from which the ETag is computed."""

    id: str
    owner: str = ""
    type: JobType
    state: JobState
    asset_id: str
    preset: str
    seed: int
    params: Mapping[str, Json]
    queue: str
    priority: Priority = "normal"
    webhook_id: str | None = None  # endpoint notified in addition to those that subscribed to all jobs
    webhook_events: Sequence[str] | None = None  # events for that endpoint; if unset, those of the job's end
    request_id: str | None = None  # id of the request that created the job
    stages: tuple[StageRecord, ...] = field(default=())
    attempt: int = 1
    version: int = 1
    error_code: str | None = None
    error_message: str | None = None
    retry_of: str | None = None
    external_id: str | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    cancel_at: float | None = None
    destination: str | None = None  # URL in a bucket for copies of the products
    processor_s: float = 0.0  # CPU time of all attempts so far
    gpu_s: float = 0.0  # time of all attempts on a GPU
    created_at: float
    started_at: float | None = None
    finished_at: float | None = None

    @property
    def terminal(self) -> bool:
        """Return whether the state is final."""
        return self.state in TERMINAL


@dataclass(frozen=True, kw_only=True)
class ClientKey:
    """Idempotency key of a request, so that sending it twice creates one job."""

    key: str
    body_sha256: str
    expires_s: float  # time until the key can be used for another job [s]


@dataclass(frozen=True, kw_only=True)
class OutputFile:
    """Output file of a stage; its bytes are already in the artefact store under their hash."""

    name: str
    media_type: str
    sha256: str
    bytes: int
    facts: Facts = field(default_factory=dict)  # a product's distances from the motion, by name; a report's warnings


@dataclass(frozen=True, kw_only=True)
class ArtifactRecord:
    """A file that a job offers."""

    id: str
    job_id: str
    stage: JobType
    name: str
    media_type: str
    sha256: str
    bytes: int
    created_at: float
    expires_at: float
    facts: Facts = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Claim:
    """The right to run one attempt of a job; it is lost unless the lease is renewed."""

    job: JobRecord
    owner: str

    @property
    def attempt(self) -> int:
        """Return the attempt's number, which fences off writes of older attempts."""
        return self.job.attempt


UploadState = Literal["receiving", "fetching", "received", "ready", "failed"]
"""In order: a client sends bytes; a URL is fetched; all bytes are stored; the asset was made; it could not be made."""


@dataclass(frozen=True, kw_only=True)
class UploadRecord:
    """One file that a client sends in pieces, or that is fetched from a URL."""

    id: str
    owner: str = ""
    state: UploadState
    filename: str
    options: Mapping[str, Json]  # options for reading the file: kind, up_axis, unit_m
    length: int | None  # None until the server of a URL reports it
    received: int = 0
    sha256: str | None = None  # announced hash; computed hash once the upload is complete
    source_url: str | None = None
    make_asset: bool = False  # make the asset without a request for it
    writer: str | None = None  # token of the request that may write
    lease_until: float | None = None  # lease of the process that fetches the file or makes the asset
    asset_id: str | None = None
    error_code: str | None = None
    error_message: str | None = None
    created_at: float
    expires_at: float


Scope = Literal["read", "write", "interact", "high-priority"]
SCOPES: tuple[Scope, ...] = get_args(Scope)
Limit = Literal[
    "active_jobs", "bytes", "creates_per_min", "reads_per_min", "chunks_per_min", "interact_per_s", "streams"
]
LIMITS: tuple[Limit, ...] = get_args(Limit)
"""Names of limits. Each is a setting `limit_…`, which a key may override."""


@dataclass(frozen=True, kw_only=True)
class KeyRecord:
    """Record of a key, without the key itself."""

    id: str
    owner: str
    name: str
    digest: str  # sha256 of the key, which itself is not stored
    scopes: tuple[Scope, ...]
    limits: Mapping[Limit, int]  # limits that override the settings
    created_at: float
    expires_at: float | None = None
    revoked_at: float | None = None
    last_used_at: float | None = None  # written at most once per hour

    def valid(self, now: float) -> bool:
        """Return whether the key is valid at a time."""
        return self.revoked_at is None and (self.expires_at is None or now < self.expires_at)


Event = Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]
EVENTS: tuple[Event, ...] = get_args(Event)
FIRST_ARTIFACT: Event = "job.first-artifact"
ENDS: tuple[Event, ...] = EVENTS[1:]
DeliveryState = Literal["pending", "delivered", "failed"]


@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """A receiver of events."""

    id: str
    owner: str
    url: str
    events: tuple[Event, ...]  # events of all jobs; if empty, only jobs that name this endpoint notify it
    secret: str = field(repr=False)
    disabled_reason: str | None = None
    created_at: float


@dataclass(frozen=True, kw_only=True)
class Try:
    """One delivery attempt."""

    at: float
    status: int | None  # None if there was no response
    detail: str
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """One message for one endpoint."""

    id: str
    endpoint_id: str
    job_id: str
    event: Event
    message_id: str  # constant over attempts, so that the receiver can detect repeats
    payload: str
    state: DeliveryState
    log: tuple[Try, ...]
    next_at: float | None  # None once delivered or given up
    created_at: float
