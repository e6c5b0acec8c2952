"""Rows of the store as dataclasses; their tables are made of them (`jobs/database/tables.py`).

Times are seconds since 1970. An `owner` is empty where no key was asked for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from jobs.states import TERMINAL, AssetKind, JobState, JobType, Priority, StageState

Json = None | bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"]
"""What a JSON column holds."""
Facts = Mapping[str, int | float | list[str]]  # what a file has to tell, by name


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
    fingerprint: str  # sha256 over everything that decides what the asset means
    parts: tuple[AssetPart, ...]  # the mesh first; photos in the order sent
    prepared: AssetPart | None  # the mesh in metres and +Z up, written by the parser's process; None for photos
    summary: Mapping[str, Json]
    metadata: Mapping[str, str] = field(default_factory=dict)
    created_at: float
    expires_at: float
    deleted_at: float | None = None

    @property
    def bytes(self) -> int:
        """Size of all files, the prepared one included [bytes]."""
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
    """One job. `version` rises with every change; the ETag is made of it."""

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
    webhook_id: str | None = None  # notified besides endpoints that subscribed to all jobs
    webhook_events: Sequence[str] | None = None  # that this endpoint gets of this job; those of its end if unset
    request_id: str | None = None  # of the request that made it
    stages: tuple[StageRecord, ...] = field(default=())
    attempt: int = 1
    version: int = 1
    error_code: str | None = None
    error_message: str | None = None
    retry_of: str | None = None
    external_id: str | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    cancel_at: float | None = None
    destination: str | None = None  # address in a bucket, for copies of its products
    processor_s: float = 0.0  # of all attempts so far
    gpu_s: float = 0.0  # during which they had a GPU
    created_at: float
    started_at: float | None = None
    finished_at: float | None = None

    @property
    def terminal(self) -> bool:
        """Whether the state is final."""
        return self.state in TERMINAL


@dataclass(frozen=True, kw_only=True)
class ClientKey:
    """Idempotency key of a request, so that sending it twice creates one job."""

    key: str
    body_sha256: str
    expires_s: float  # after which the key may mean another job [s]


@dataclass(frozen=True, kw_only=True)
class OutputFile:
    """A file that a stage made, its bytes already in the artefact store under their hash."""

    name: str
    media_type: str
    sha256: str
    bytes: int
    facts: Facts = field(default_factory=dict)  # how far it is from the motion, by name; warnings of a report


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
    """The right to run one attempt of a job. Whoever holds it renews the lease, or loses it."""

    job: JobRecord
    owner: str

    @property
    def attempt(self) -> int:
        """Number of the attempt, which fences off writes of older attempts."""
        return self.job.attempt


UploadState = Literal["receiving", "fetching", "received", "ready", "failed"]
"""Bytes come from a client, or from an address; all are there; an asset was made; it could not be."""


@dataclass(frozen=True, kw_only=True)
class UploadRecord:
    """One file that someone sends in pieces, or that is fetched from an address."""

    id: str
    owner: str = ""
    state: UploadState
    filename: str
    options: Mapping[str, Json]  # how to read it: kind, up_axis, unit_m
    length: int | None  # unset while an address does not tell
    received: int = 0
    sha256: str | None = None  # as promised; as found once it is whole
    source_url: str | None = None
    make_asset: bool = False  # without being asked for it
    writer: str | None = None  # the request that may write
    lease_until: float | None = None  # of the process that fetches, or makes the asset
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
"""Each is a setting `limit_…`; a key may have its own."""


@dataclass(frozen=True, kw_only=True)
class KeyRecord:
    """Record of a key, without the key itself."""

    id: str
    owner: str
    name: str
    digest: str  # sha256 of the key, which is nowhere
    scopes: tuple[Scope, ...]
    limits: Mapping[Limit, int]  # what differs from the settings
    created_at: float
    expires_at: float | None = None
    revoked_at: float | None = None
    last_used_at: float | None = None  # written once an hour at most

    def valid(self, now: float) -> bool:
        """Whether the key is valid at a time."""
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
    events: tuple[Event, ...]  # of every job; none: only of jobs that name this endpoint
    secret: str = field(repr=False)
    disabled_reason: str | None = None
    created_at: float


@dataclass(frozen=True, kw_only=True)
class Try:
    """One delivery attempt."""

    at: float
    status: int | None  # none where no answer came
    detail: str
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """One message for one endpoint."""

    id: str
    endpoint_id: str
    job_id: str
    event: Event
    message_id: str  # the same for each attempt, so that the receiver may know it
    payload: str
    state: DeliveryState
    log: tuple[Try, ...]
    next_at: float | None  # null once it is over
    created_at: float
