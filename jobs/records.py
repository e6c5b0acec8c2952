"""Rows of the store as dataclasses. Times are seconds since 1970."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

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
    owner: str = ""  # empty where no key was asked for
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
    traceparent: str | None = None  # W3C trace context of that request
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
