"""Bodies of jobs and manifests: parameters from `dynamictree.requests`, and what only the service needs."""

from typing import Annotated, Literal

from pydantic import Field

from dynamictree.requests import AnimateParams, DiffuseParams, ModelParams, ReconstructParams, VoxelizeParams
from jobs.records import EVENTS, ArtifactRecord, Event, JobRecord
from jobs.states import JobState, JobType, Priority, StageState
from service.schemas.assets import AssetSummary
from service.schemas.base import ULID_PATTERN, Metadata, Payload, Problem, Time


class _JobRequest(ModelParams):
    priority: Priority = Field(
        default="normal", description="high is begun first; with keys, one of scope high-priority"
    )
    webhook: str | None = Field(
        default=None, pattern=ULID_PATTERN, description="id of a webhook endpoint that gets events of this job"
    )
    webhook_events: list[Event] | None = Field(
        default=None, max_length=len(EVENTS), description="which of them; those of its end if unset"
    )
    asset_id: str = Field(max_length=64, description="what POST /v1/assets gave")
    external_id: str | None = Field(
        default=None,
        min_length=1,
        max_length=128,
        description="your name for the job, by which lists can be filtered",
    )
    metadata: Metadata = Field(default_factory=dict, description="texts of yours, returned as they are")
    destination: str | None = Field(
        default=None, min_length=1, max_length=1024, description="where in an allowed bucket products are copied to"
    )
    cancel_after_s: Annotated[float, Field(gt=0, le=604_800, allow_inf_nan=False)] | None = Field(
        default=None, description="canceled if it has not ended by then, running or not [s]"
    )


class ReconstructRequest(_JobRequest):
    """Reconstruct a mesh from photos."""

    type: Literal["reconstruct"]
    params: ReconstructParams = Field(default_factory=ReconstructParams)


class VoxelizeRequest(_JobRequest):
    """Compute the occupied voxels and their normals."""

    type: Literal["voxelize"]
    params: VoxelizeParams = Field(default_factory=VoxelizeParams)


class DiffuseRequest(_JobRequest):
    """Generate a spectrum."""

    type: Literal["diffuse"]
    params: DiffuseParams = Field(default_factory=DiffuseParams)


class AnimateRequest(_JobRequest):
    """Generate a motion and write it as files."""

    type: Literal["animate"]
    params: AnimateParams = Field(default_factory=AnimateParams)


JobRequest = Annotated[
    ReconstructRequest | VoxelizeRequest | DiffuseRequest | AnimateRequest, Field(discriminator="type")
]


class StagePayload(Payload):
    """One stage of a job."""

    name: JobType
    state: StageState
    progress: float = Field(ge=0, le=1)
    cached: bool = Field(description="taken from an earlier job with the same inputs")
    started_at: Time | None = Field(description="earlier by the work of attempts that the stage continues")
    finished_at: Time | None


class ResultPayload(Payload):
    """Ids of the products."""

    mesh_id: str | None = Field(description="artefact of the reconstructed mesh")
    voxels_id: str | None
    spectrum_id: str | None = Field(description="for /v1/spectra and /v1/interact")
    source: AssetSummary | None = Field(
        description="how what was uploaded was read, as in the asset's `summary`: height, up axis, unit, `warnings`, "
        "`still_parts`; null once the asset's record is removed"
    )
    warnings: list[str] = Field(description="of photos: what makes the reconstruction doubtful, and what to do")
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
    progress: float = Field(
        ge=0, le=1, description="mean over the stages; of photos weighed by the time that stages usually take"
    )
    queue_position: int | None = Field(description="jobs before this one; null once it has begun")
    eta_s: float | None = Field(description="null where it is not known")
    stages: list[StagePayload]
    result: ResultPayload | None = Field(description="what is there so far; null before the first product")
    error: Problem | None
    priority: Priority
    webhook: str | None
    retry_of: str | None
    external_id: str | None
    metadata: dict[str, str]
    cancel_at: Time | None
    destination: str | None
    processor_s: float = Field(description="processor time of all attempts that have ended [s]")
    gpu_s: float = Field(description="time of theirs on a worker with a GPU [s]")
    created_at: Time
    started_at: Time | None
    finished_at: Time | None
    expires_at: Time | None = Field(description="when its record is removed; null until it has ended")


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
    """Files that a job has produced."""

    job_id: str
    complete: bool = Field(description="whether the job has succeeded and nothing will be added")
    artifacts: list[ArtifactPayload]


def manifest_payload(job: JobRecord, artifacts: list[ArtifactRecord]) -> ManifestPayload:
    """Return a job's manifest as a response body."""
    listed = [
        ArtifactPayload.of(
            artifact,
            facts={k: v for k, v in artifact.facts.items() if k != "warnings"},
            url=f"/v1/artifacts/{artifact.id}",
        )
        for artifact in artifacts
    ]
    return ManifestPayload(job_id=job.id, complete=job.state == JobState.SUCCEEDED, artifacts=listed)
