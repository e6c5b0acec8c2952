"""Bodies that create jobs: parameters from `dynamictree.requests` and what only the service needs."""

from typing import Annotated, Literal

from pydantic import Field

from dynamictree.requests import AnimateParams, DiffuseParams, ModelParams, ReconstructParams, VoxelizeParams
from jobs.records import EVENTS, Event
from jobs.states import Priority
from service.schemas.base import ULID_PATTERN, Metadata


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
