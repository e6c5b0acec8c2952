"""What a job may be asked for."""

from typing import Annotated, Literal

from pydantic import Field

from jobs.states import JobType, Priority
from service.schemas.base import MAX_FRAMES, ULID_PATTERN, Finite, Payload, WindPayload

MAX_SEED = 2**53 - 1
"""The largest integer that every JSON reader keeps exact."""

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
        default=None, pattern=ULID_PATTERN, description="id of a webhook endpoint to tell of the end"
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


class RetryRequest(Payload):
    """How to run a job again."""

    from_stage: JobType | None = Field(
        default=None, description="this stage and those after it run anew; without it, what is cached is taken"
    )
