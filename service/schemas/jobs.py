"""Bodies of jobs and manifests: parameters from `dynamictree.requests`, and what only the service needs."""

from typing import Annotated, Literal

from pydantic import Field

from dynamictree.requests import AnimateParams, DiffuseParams, ModelParams, ReconstructParams, VoxelizeParams
from jobs.records import EVENTS, ArtifactRecord, Event, JobRecord
from jobs.states import JobState, JobType, Priority, StageState
from service.schemas.assets import AssetSummary
from service.schemas.base import Metadata, Payload, Problem, Time, Ulid


class _JobRequest(ModelParams):
    priority: Priority = Field(
        default="normal", description="high runs first; if keys are required, it needs the scope high-priority"
    )
    webhook: Ulid | None = Field(default=None, description="Id of a webhook endpoint that receives events of this job")
    webhook_events: list[Event] | None = Field(
        default=None, max_length=len(EVENTS), description="Events to send; by default those of the job's end"
    )
    asset_id: str = Field(max_length=64, description="Id that POST /v1/assets returned")
    external_id: str | None = Field(
        default=None, min_length=1, max_length=128, description="Your name for the job, for filtering lists"
    )
    metadata: Metadata = Field(default_factory=dict, description="Your texts, returned unchanged")
    destination: str | None = Field(
        default=None, min_length=1, max_length=1024, description="URL in an allowed bucket to which products are copied"
    )
    cancel_after_s: Annotated[float, Field(gt=0, le=604_800, allow_inf_nan=False)] | None = Field(
        default=None, description="Time after which the job is canceled unless it has ended [s]"
    )


class ReconstructRequest(_JobRequest):
    """Reconstruct a mesh from photos or a cloud."""

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
    cached: bool = Field(description="True if taken from an earlier job with the same inputs")
    started_at: Time | None = Field(description="Start, moved back by the work of earlier attempts")
    finished_at: Time | None


class ResultPayload(Payload):
    """Ids of the products."""

    mesh_id: str | None = Field(description="Artifact of the reconstructed mesh")
    voxels_id: str | None
    spectrum_id: str | None = Field(description="Id for /v1/spectra and /v1/interact")
    source: AssetSummary | None = Field(
        description="How the upload was read, as in the asset's `summary`: height, up axis, unit, `warnings`, "
        "`still_parts`; null once the asset's record is deleted"
    )
    warnings: list[str] = Field(description="Warnings about a reconstruction, with advice")
    artifacts_url: str


class JobPayload(Payload):
    """Current state of a job."""

    id: str
    type: JobType
    state: JobState
    asset_id: str
    preset: str
    seed: int
    params: dict[str, object]
    attempt: int
    progress: float = Field(ge=0, le=1, description="Mean over the stages; of photos, weighted by typical durations")
    queue_position: int | None = Field(description="Number of jobs before this one; null once started")
    eta_s: float | None = Field(description="Remaining time [s]; null if unknown")
    stages: list[StagePayload]
    result: ResultPayload | None = Field(description="Products so far; null before the first")
    error: Problem | None
    priority: Priority
    webhook: str | None
    retry_of: str | None
    external_id: str | None
    metadata: dict[str, str]
    cancel_at: Time | None
    destination: str | None
    processor_s: float = Field(description="CPU time of all ended attempts [s]")
    gpu_s: float = Field(description="Run time of ended attempts on a GPU worker [s]")
    created_at: Time
    started_at: Time | None
    finished_at: Time | None
    expires_at: Time | None = Field(description="Time at which its record is deleted; null until it ends")


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
        default_factory=dict, description="Errors of the file against the motion; names with _m are in metres"
    )
    created_at: Time
    expires_at: Time


class ManifestPayload(Payload):
    """Files that a job has produced."""

    job_id: str
    complete: bool = Field(description="True if the job has succeeded and adds no more files")
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
