"""Bodies of requests and responses: what the OpenAPI page shows. Unknown fields are refused."""

from datetime import UTC, datetime
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from jobs.joblog import Level
from jobs.keys import Limit
from jobs.products import MESH, SPECTRUM, VOXELS
from jobs.records import ArtifactRecord, AssetRecord, JobRecord
from jobs.states import AssetKind, JobState, JobType, Priority, StageState
from jobs.uploads import UploadRecord, UploadState
from jobs.webhooks import EVENTS, DeliveryState, Event
from service.problems import KINDS, problem_body

MAX_SEED = 2**53 - 1
"""The largest integer that every JSON reader keeps exact."""

MAX_FRAMES = 600


Finite = Annotated[float, Field(allow_inf_nan=False)]


class Payload(BaseModel):
    """Root of all bodies."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class WindPayload(Payload):
    """The wind that the motion is generated for."""

    speed_m_s: Finite = Field(default=5.0, ge=0, le=30, description="mean speed [m/s]")
    direction_deg: Finite = Field(default=0.0, ge=-360, le=360, description="where it blows to, from +X towards +Y [°]")
    gust: Finite = Field(default=0.3, ge=0, le=2, description="standard deviation of the speed over its mean")


Box = tuple[tuple[Finite, Finite, Finite], tuple[Finite, Finite, Finite]]


Format = Literal[
    "ply", "glb", "glb-reduced", "glb-skinned", "usd", "vat", "motion", "splat-ply", "splat", "png", "webp", "mp4"
]


class ReconstructParams(Payload):
    """Photos or a cloud to a mesh."""

    box_m: Box | None = Field(
        default=None, description="of a cloud, only what is inside moves: low and high corner [m], +Z up; all if unset"
    )
    height_m: Finite | None = Field(
        default=None,
        gt=0,
        lt=1000,
        description="of photos: the tree's height [m], which they do not tell; 1 m if unset",
    )
    splat_steps: int | None = Field(
        default=None,
        ge=100,
        le=30_000,
        description="of photos: how long the splat is learned; the usual number if unset",
    )


class VoxelizeParams(ReconstructParams):
    """Surface to voxels."""

    resolution: Literal[32, 64, 128, 256, 512] = Field(default=128, description="voxels along the cube's side")


class DiffuseParams(ReconstructParams):
    """Shape to spectrum."""

    wind: WindPayload = Field(default_factory=WindPayload)
    num_steps: int | None = Field(default=None, ge=1, le=1000, description="sampler steps; the preset's own if unset")


class ShotPayload(Payload):
    """From where the pictures are taken."""

    side_px: int = Field(default=512, ge=64, le=1080)
    azimuth_deg: Finite = Field(default=25.0, ge=-360, le=360, description="0 stands at -Y; grows towards +X [°]")
    elevation_deg: Finite = Field(default=8.0, ge=-30, le=80, description="[°]")
    orbit: bool = Field(default=False, description="goes around once while the frames go by")
    ground: bool = Field(default=True, description="a floor with a shadow")


class AnimateParams(DiffuseParams):
    """Spectrum to motion, and the files that show it. `share` and `sh_degree` make splats lighter."""

    first_frame: int = Field(default=0, ge=0, lt=MAX_FRAMES)
    num_frames: int | None = Field(default=None, ge=1, le=MAX_FRAMES, description="one period if unset")
    fps: Finite = Field(default=24.0, ge=1, le=240, description="frames a second; never changes the speed")
    speed: Finite = Field(default=1.0, ge=0.01, le=100, description="times the natural speed")
    loop: bool = Field(default=True, description="refuse a number of frames that is no whole number of periods")
    formats: tuple[Format, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=16,
        description="files to make; ply, glb and png of a mesh or photos, splat and png of a cloud if unset. "
        "png comes with every motion",
    )
    share: Finite = Field(default=1.0, gt=0, le=1, description="of a splat's Gaussians that are kept")
    sh_degree: int = Field(default=3, ge=0, le=3, description="of a splat's harmonics, at most")
    shot: ShotPayload = Field(default_factory=ShotPayload)


class _JobRequest(Payload):
    priority: Priority = Field(
        default="normal", description="high is begun first; with keys, one of scope high-priority"
    )
    webhook: str | None = Field(
        default=None, pattern="^[0-9A-HJKMNP-TV-Z]{26}$", description="id of a webhook endpoint to tell of the end"
    )
    asset_id: str = Field(max_length=64, description="what POST /v1/assets gave")
    preset: str = Field(default="small", max_length=64, description="the model, see GET /v1/presets")
    seed: int = Field(default=0, ge=0, le=MAX_SEED, description="the same seed gives the same motion")
    start_deadline_s: Annotated[float, Field(gt=0, le=604_800, allow_inf_nan=False)] | None = Field(
        default=None, description="aborted if no worker has begun by then [s]"
    )


class ReconstructRequest(_JobRequest):
    """Photos to a mesh."""

    type: Literal["reconstruct"]
    params: ReconstructParams = Field(default_factory=ReconstructParams)


class VoxelizeRequest(_JobRequest):
    """To the occupied voxels and their normals."""

    type: Literal["voxelize"]
    params: VoxelizeParams = Field(default_factory=VoxelizeParams)


class DiffuseRequest(_JobRequest):
    """To the spectrum."""

    type: Literal["diffuse"]
    params: DiffuseParams = Field(default_factory=DiffuseParams)


class AnimateRequest(_JobRequest):
    """To the motion."""

    type: Literal["animate"]
    params: AnimateParams = Field(default_factory=AnimateParams)


JobRequest = Annotated[
    ReconstructRequest | VoxelizeRequest | DiffuseRequest | AnimateRequest, Field(discriminator="type")
]

Time = Annotated[datetime, Field(description="RFC 3339, UTC")]


class PartPayload(Payload):
    """One file of an asset."""

    name: str
    sha256: str
    bytes: int


class AssetPayload(Payload):
    """An upload that was read and can be used."""

    id: str
    kind: AssetKind
    parts: list[PartPayload]
    summary: dict[str, str | int | float | list[float] | None] = Field(
        description="what was found in it; lengths in metres"
    )
    created_at: Time
    expires_at: Time


class AssetRequest(Payload):
    """What to make an asset of: uploads that are whole, or an address."""

    upload_ids: list[Annotated[str, Field(pattern="^[0-9A-HJKMNP-TV-Z]{26}$")]] | None = Field(
        default=None, min_length=1, max_length=320, description="a mesh and what it names, photos, or one zip"
    )
    url: str | None = Field(default=None, max_length=2048, description="https; fetched once, redirects are checked too")
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$", description="of the file at the address")
    filename: str | None = Field(default=None, min_length=1, max_length=255, description="the address' own if unset")
    kind: AssetKind | None = Field(default=None, description="by name if unset")
    up_axis: Literal["+X", "-X", "+Y", "-Y", "+Z", "-Z"] | None = Field(
        default=None, description="the format's own if unset"
    )
    unit_m: Finite | None = Field(default=None, ge=1e-6, le=1e6, description="metres a unit")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.upload_ids is None) == (self.url is None):
            raise ValueError("give either upload_ids or url")
        if self.url is None and (self.sha256 or self.filename):
            raise ValueError("sha256 and filename go with url; those of uploads are in Upload-Metadata")
        return self


class UploadPayload(Payload):
    """A file that comes in pieces, or from an address."""

    id: str
    state: UploadState = Field(description="receiving or fetching; received; ready with an asset; failed")
    filename: str
    bytes_received: int
    length: int | None = Field(description="null while an address does not tell")
    sha256: str | None = Field(description="as promised")
    asset_id: str | None
    error: "Problem | None"
    created_at: Time
    expires_at: Time


class StagePayload(Payload):
    """One stage of a job."""

    name: JobType
    state: StageState
    progress: float = Field(ge=0, le=1)
    cached: bool = Field(description="taken from an earlier job with the same inputs")
    started_at: Time | None
    finished_at: Time | None


class FieldErrorPayload(Payload):
    """One field that is wrong."""

    pointer: str = Field(description="JSON pointer into the body, or where:name")
    code: str
    detail: str


class Problem(BaseModel):
    """RFC 9457. Some problems have members of their own besides."""

    model_config = ConfigDict(extra="allow", frozen=True)

    type: str = Field(description="urn:dynamictree:problem:CODE")
    title: str
    status: int
    detail: str
    code: str
    request_id: str | None
    retryable: bool
    suggestion: str
    errors: list[FieldErrorPayload]


class ResultPayload(Payload):
    """Where the products are."""

    mesh_id: str | None = Field(description="artefact of the reconstructed mesh")
    voxels_id: str | None
    spectrum_id: str | None = Field(description="for /v1/spectra and /v1/interact")
    artifacts_url: str


class JobPayload(Payload):
    """A job as it is now."""

    id: str
    type: JobType
    state: JobState
    asset_id: str
    preset: str
    seed: int
    params: dict[str, object]
    attempt: int
    progress: float = Field(ge=0, le=1, description="mean over the stages")
    queue_position: int | None = Field(description="jobs before this one; null once it has begun")
    eta_s: float | None = Field(description="null where it is not known")
    stages: list[StagePayload]
    result: ResultPayload | None = Field(description="what is there so far; null before the first product")
    error: Problem | None
    priority: Priority
    webhook: str | None
    retry_of: str | None
    start_deadline_at: Time | None
    created_at: Time
    started_at: Time | None
    finished_at: Time | None
    expires_at: Time | None = Field(description="when its record is removed; null until it has ended")


class EstimatePayload(Payload):
    """A request that would be accepted, and what it would take."""

    valid: Literal[True] = True
    est_seconds: float | None = Field(description="median of this service's own history [s]; null without one")
    est_bytes: int | None = Field(description="of all products, likewise")
    format_bytes: dict[str, int] = Field(description="of the products whose size is known before they are made")


class RetryRequest(Payload):
    """How to run a job again."""

    from_stage: JobType | None = Field(
        default=None, description="this stage and those after it run anew; without it, what is cached is taken"
    )


class BatchRequest(Payload):
    """Several jobs at once."""

    jobs: list[JobRequest] = Field(min_length=1, max_length=100)


class BatchItemPayload(Payload):
    """What became of one job of a batch: the job, or why there is none."""

    status: int = Field(description="what the request would have been answered by itself")
    job: JobPayload | None
    problem: Problem | None


class BatchPayload(Payload):
    """What became of a batch, in its order."""

    data: list[BatchItemPayload]


class LogLinePayload(Payload):
    """One line of a job's log."""

    id: int = Field(description="for `after`")
    at: Time
    level: Level
    message: str
    fields: dict[str, object]


class LogPayload(Payload):
    """What happened to a job, oldest first."""

    data: list[LogLinePayload]
    next_after: int = Field(description="send as `after` to go on")


class EndpointRequest(Payload):
    """An address to tell."""

    url: str = Field(max_length=2048, description="https")
    events: tuple[Event, ...] = Field(
        default=EVENTS, max_length=len(EVENTS), description="of every job; none: only of jobs that name the endpoint"
    )


class EndpointPayload(Payload):
    """An address that is told."""

    id: str
    url: str
    events: list[Event]
    disabled_reason: str | None
    created_at: Time


class EndpointWithSecretPayload(EndpointPayload):
    """The only time that a secret is shown."""

    secret: str = Field(description="whsec_ and base64: the key of HMAC-SHA256 over id.timestamp.body")


class EndpointListPayload(Payload):
    """Every address that is told."""

    data: list[EndpointPayload]


class TryPayload(Payload):
    """One attempt to tell."""

    at: Time
    status: int | None = Field(description="null where no answer came")
    detail: str
    seconds: float


class DeliveryPayload(Payload):
    """A message for one address."""

    id: str
    message_id: str = Field(description="the header webhook-id; a replay has the same")
    event: Event
    job_id: str
    state: DeliveryState
    tries: list[TryPayload]
    next_at: Time | None = Field(description="the next attempt; null once it is over")
    created_at: Time


class DeliveryListPayload(Payload):
    """A page of deliveries, newest first."""

    data: list[DeliveryPayload]
    next_cursor: str | None


class UsagePayload(Payload):
    """What the caller has, and may have; null where no key is asked for."""

    owner: str | None
    active_jobs: int
    bytes: int
    limits: dict[Limit, int] | None


class JobListPayload(Payload):
    """A page of jobs, newest first."""

    data: list[JobPayload]
    next_cursor: str | None


class ArtifactPayload(Payload):
    """A file to download."""

    id: str
    name: str
    stage: JobType
    media_type: str
    bytes: int
    sha256: str
    url: str
    facts: dict[str, int | float] = Field(
        default_factory=dict, description="where a file is not exact, how far it is from the motion; [m] as _m says"
    )
    created_at: Time
    expires_at: Time


class ManifestPayload(Payload):
    """What a job offers."""

    job_id: str
    complete: bool = Field(description="whether the job has succeeded and nothing will be added")
    artifacts: list[ArtifactPayload]


def time_of(seconds: float) -> datetime:
    """Seconds since 1970 as a time."""
    return datetime.fromtimestamp(seconds, UTC)


def maybe_time(seconds: float | None) -> datetime | None:
    """A time that may not be."""
    return None if seconds is None else time_of(seconds)


def asset_payload(asset: AssetRecord) -> AssetPayload:
    """An asset as it is told."""
    return AssetPayload(
        id=asset.id,
        kind=asset.kind,
        parts=[PartPayload(name=part.name, sha256=part.sha256, bytes=part.bytes) for part in asset.parts],
        summary=dict(asset.summary),
        created_at=time_of(asset.created_at),
        expires_at=time_of(asset.expires_at),
    )


def upload_payload(upload: UploadRecord, size: int) -> UploadPayload:
    """An upload as it is told, with the bytes that are there."""
    return UploadPayload(
        id=upload.id,
        state=upload.state,
        filename=upload.filename,
        bytes_received=size,
        length=upload.length,
        sha256=upload.sha256,
        asset_id=upload.asset_id,
        error=_problem(upload.error_code, upload.error_message),
        created_at=time_of(upload.created_at),
        expires_at=time_of(upload.expires_at),
    )


def _problem(code: str | None, message: str | None) -> Problem | None:
    if code is None:
        return None
    known = code if code in KINDS else "internal-error"
    return Problem.model_validate(problem_body(known, message or "", request_id=None))


def job_payload(
    job: JobRecord,
    artifacts: list[ArtifactRecord],
    *,
    queue_position: int | None,
    eta_s: float | None,
    retention_s: float,
) -> JobPayload:
    """A job as it is told."""
    stages = [
        StagePayload(
            name=stage.name,
            state=stage.state,
            progress=stage.progress,
            cached=stage.cached,
            started_at=maybe_time(stage.started_at),
            finished_at=maybe_time(stage.finished_at),
        )
        for stage in job.stages
    ]
    return JobPayload(
        id=job.id,
        type=job.type,
        state=job.state,
        asset_id=job.asset_id,
        preset=job.preset,
        seed=job.seed,
        params=dict(job.params),
        attempt=job.attempt,
        progress=sum(stage.progress for stage in stages) / len(stages),
        queue_position=queue_position,
        eta_s=eta_s,
        stages=stages,
        result=_result(job, artifacts),
        error=_problem(job.error_code, job.error_message),
        priority=job.priority,
        webhook=job.webhook_id,
        retry_of=job.retry_of,
        start_deadline_at=maybe_time(job.start_deadline),
        created_at=time_of(job.created_at),
        started_at=maybe_time(job.started_at),
        finished_at=maybe_time(job.finished_at),
        expires_at=maybe_time(None if job.finished_at is None else job.finished_at + retention_s),
    )


def _result(job: JobRecord, artifacts: list[ArtifactRecord]) -> ResultPayload | None:
    if not artifacts:
        return None
    ids = {artifact.name: artifact.id for artifact in artifacts}
    return ResultPayload(
        mesh_id=ids.get(MESH),
        voxels_id=ids.get(VOXELS),
        spectrum_id=ids.get(SPECTRUM),
        artifacts_url=f"/v1/jobs/{job.id}/artifacts",
    )


def manifest_payload(job: JobRecord, artifacts: list[ArtifactRecord]) -> ManifestPayload:
    """A job's manifest as it is told."""
    listed = [
        ArtifactPayload(
            id=artifact.id,
            name=artifact.name,
            stage=artifact.stage,
            media_type=artifact.media_type,
            bytes=artifact.bytes,
            sha256=artifact.sha256,
            url=f"/v1/artifacts/{artifact.id}",
            facts=dict(artifact.facts),
            created_at=time_of(artifact.created_at),
            expires_at=time_of(artifact.expires_at),
        )
        for artifact in artifacts
    ]
    return ManifestPayload(job_id=job.id, complete=job.state == JobState.SUCCEEDED, artifacts=listed)
