"""What requests and answers hold. Made by client/generate.py; do not edit."""

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    """Root of all. What a newer service adds is passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)


JobState = Literal["queued", "running", "canceling", "succeeded", "failed", "canceled", "aborted"]
"""Where a job is. The last four are final."""


class AnimateParams(Model):
    """Spectrum to motion, and the files that show it. `share` and `sh_degree` make splats lighter."""

    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = (
        None  # of a cloud, only what is inside moves: low and high corner [m], +Z up; all if unset
    )
    wind: "Wind | None" = None
    num_steps: int | None = None  # sampler steps; the preset's own if unset
    first_frame: int = 0
    num_frames: int | None = None  # one period if unset
    fps: float = 24.0  # frames a second; never changes the speed
    speed: float = 1.0  # times the natural speed
    loop: bool = True  # refuse a number of frames that is no whole number of periods
    formats: (
        list[
            Literal[
                "ply",
                "glb",
                "glb-reduced",
                "glb-skinned",
                "usd",
                "vat",
                "motion",
                "splat-ply",
                "splat",
                "png",
                "webp",
                "mp4",
            ]
        ]
        | None
    ) = None  # files to make; ply, glb and png of a mesh or photos, splat and png of a cloud if unset. png comes with every motion
    share: float = 1.0  # of a splat's Gaussians that are kept
    sh_degree: int = 3  # of a splat's harmonics, at most
    shot: "Shot | None" = None


class AnimateRequest(Model):
    """To the motion."""

    priority: Literal["high", "normal", "low"] = "normal"  # high is begun first; with keys, one of scope high-priority
    webhook: str | None = None  # id of a webhook endpoint to tell of the end
    asset_id: str  # what POST /v1/assets gave
    preset: str = "small"  # the model, see GET /v1/presets
    seed: int = 0  # the same seed gives the same motion
    start_deadline_s: float | None = None  # aborted if no worker has begun by then [s]
    type: Literal["animate"]
    params: "AnimateParams | None" = None


class Artifact(Model):
    """A file to download."""

    id: str
    name: str
    stage: Literal["reconstruct", "voxelize", "diffuse", "animate"]
    media_type: str
    bytes: int
    sha256: str
    url: str
    facts: dict[str, int | float] | None = (
        None  # where a file is not exact, how far it is from the motion; [m] as _m says
    )
    created_at: datetime  # RFC 3339, UTC
    expires_at: datetime  # RFC 3339, UTC


class Asset(Model):
    """An upload that was read and can be used."""

    id: str
    kind: Literal["mesh", "photos", "cloud"]
    parts: "list[Part]"
    summary: dict[str, str | int | float | list[float] | None]  # what was found in it; lengths in metres
    created_at: datetime  # RFC 3339, UTC
    expires_at: datetime  # RFC 3339, UTC


class At(Model):
    """Where a force acts: exactly one of point, vertex and voxel."""

    point_m: tuple[float, float, float] | None = None  # the nearest voxel to it
    vertex: int | None = None  # index into the source mesh's vertices
    voxel: int | None = None  # row in the spectrum's coords
    radius_m: float = 0.0  # spread evenly over the voxels within it


class BatchItem(Model):
    """What became of one job of a batch: the job, or why there is none."""

    status: int  # what the request would have been answered by itself
    job: "Job | None"
    problem: "Problem | None"


class Batch(Model):
    """What became of a batch, in its order."""

    data: "list[BatchItem]"


class BatchRequest(Model):
    """Several jobs at once."""

    jobs: "list[ReconstructRequest | VoxelizeRequest | DiffuseRequest | AnimateRequest]"


class DeliveryList(Model):
    """A page of deliveries, newest first."""

    data: "list[Delivery]"
    next_cursor: str | None


class Delivery(Model):
    """A message for one address."""

    id: str
    message_id: str  # the header webhook-id; a replay has the same
    event: Literal["job.succeeded", "job.failed", "job.canceled", "job.aborted"]
    job_id: str
    state: Literal["pending", "delivered", "failed"]
    tries: "list[Try]"
    next_at: datetime | None  # the next attempt; null once it is over
    created_at: datetime  # RFC 3339, UTC


class DiffuseParams(Model):
    """Shape to spectrum."""

    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = (
        None  # of a cloud, only what is inside moves: low and high corner [m], +Z up; all if unset
    )
    wind: "Wind | None" = None
    num_steps: int | None = None  # sampler steps; the preset's own if unset


class DiffuseRequest(Model):
    """To the spectrum."""

    priority: Literal["high", "normal", "low"] = "normal"  # high is begun first; with keys, one of scope high-priority
    webhook: str | None = None  # id of a webhook endpoint to tell of the end
    asset_id: str  # what POST /v1/assets gave
    preset: str = "small"  # the model, see GET /v1/presets
    seed: int = 0  # the same seed gives the same motion
    start_deadline_s: float | None = None  # aborted if no worker has begun by then [s]
    type: Literal["diffuse"]
    params: "DiffuseParams | None" = None


class EndpointList(Model):
    """Every address that is told."""

    data: "list[Endpoint]"


class Endpoint(Model):
    """An address that is told."""

    id: str
    url: str
    events: list[Literal["job.succeeded", "job.failed", "job.canceled", "job.aborted"]]
    disabled_reason: str | None
    created_at: datetime  # RFC 3339, UTC


class EndpointRequest(Model):
    """An address to tell."""

    url: str  # https
    events: list[Literal["job.succeeded", "job.failed", "job.canceled", "job.aborted"]] = [
        "job.succeeded",
        "job.failed",
        "job.canceled",
        "job.aborted",
    ]  # of every job; none: only of jobs that name the endpoint


class EndpointWithSecret(Model):
    """The only time that a secret is shown."""

    id: str
    url: str
    events: list[Literal["job.succeeded", "job.failed", "job.canceled", "job.aborted"]]
    disabled_reason: str | None
    created_at: datetime  # RFC 3339, UTC
    secret: str  # whsec_ and base64: the key of HMAC-SHA256 over id.timestamp.body


class Estimate(Model):
    """A request that would be accepted, and what it would take."""

    valid: Literal[True] = True
    est_seconds: float | None  # median of this service's own history [s]; null without one
    est_bytes: int | None  # of all products, likewise
    format_bytes: dict[str, int]  # of the products whose size is known before they are made


class FieldError(Model):
    """One field that is wrong."""

    pointer: str  # JSON pointer into the body, or where:name
    code: str
    detail: str


class Force(Model):
    """One push."""

    kind: Literal["impulse", "drag", "wind"]
    at: "At | None" = None  # of an impulse or a drag; wind blows everywhere
    impulse_n_s: tuple[float, float, float] | None = None  # [N s], of an impulse
    force_n: tuple[float, float, float] | None = None  # [N], of a drag; or displacement_m
    displacement_m: tuple[float, float, float] | None = (
        None  # [m], of a drag: where the point would rest under the force that is then held
    )
    wind_m_s: tuple[float, float, float] | list[tuple[float, float, float]] | None = (
        None  # [m/s], of wind; several are samples, evenly spaced over the duration
    )
    start_s: float = 0.0  # from the first frame of this call [s]
    duration_s: float | None = None  # [s]; unset: within one step for an impulse, to the end for others


class Group(Model):
    """One group's modal coordinates."""

    locality: "Locality | None"  # null: the whole tree
    q: list[list[tuple[float, float]]]  # [frames, K]; index = frequency bin, bin 0 is no mode and 0


class GroupState(Model):
    """One group's coordinates: K complex numbers, index = frequency bin; bin 0 is no mode and stays 0."""

    locality: "Locality | None"  # null: the whole tree
    q: list[tuple[float, float]]
    q_dot: list[tuple[float, float]]  # [1/s]


class Interact(Model):
    """Modal coordinates. With φ_k = 2c_k of the spectrum, u(p) = Σ_g w_g(p) Re Σ_k φ_k(p) q_{g,k}."""

    spectrum_id: str
    output: Literal["modal", "voxels", "vertices", "gaussians"]
    integrator: str
    dt_s: float
    num_frames: int
    frequencies_hz: list[float]
    mass_kg: float
    modal_mass_kg_m2: float  # m of m (q̈ + 2ζω q̇ + ω² q) = Σ conj(φ)·F
    groups: "list[Group]"
    final_state: "State"  # the next call's initial_state


class InteractRequest(Model):
    """Push a tree."""

    spectrum_id: str  # from a job's result
    forces: "list[Force] | None" = None
    damping_ratio: float = 0.05  # of every mode; 1 is critical
    mass_kg: float | None = None  # that moves; by the height if unset
    dt_s: float = 0.016666666666666666  # of a step, which is a frame [s]
    num_frames: int = 60
    integrator: Literal["exact", "symplectic-euler", "explicit-euler"] = "exact"
    start: Literal["rest", "held", "davis"] = (
        "rest"  # without initial_state: at rest, held in equilibrium with the forces, or Davis'
    )
    initial_state: "State | None" = None  # final_state of an earlier call
    locality: Literal["none", "geodesic"] = "geodesic"  # what a push may reach
    falloff_m: float | None = None  # [m]; 15 % of the height if unset
    warp: bool = False  # bend, do not stretch; changes voxels and vertices, not modal
    output: Literal["modal", "voxels", "vertices", "gaussians"] = "modal"


class JobList(Model):
    """A page of jobs, newest first."""

    data: "list[Job]"
    next_cursor: str | None


class Job(Model):
    """A job as it is now."""

    id: str
    type: Literal["reconstruct", "voxelize", "diffuse", "animate"]
    state: "JobState"
    asset_id: str
    preset: str
    seed: int
    params: dict[str, Any]
    attempt: int
    progress: float  # mean over the stages
    queue_position: int | None  # jobs before this one; null once it has begun
    eta_s: float | None  # null where it is not known
    stages: "list[Stage]"
    result: "Result | None"  # what is there so far; null before the first product
    error: "Problem | None"
    priority: Literal["high", "normal", "low"]
    webhook: str | None
    retry_of: str | None
    start_deadline_at: datetime | None
    created_at: datetime  # RFC 3339, UTC
    started_at: datetime | None
    finished_at: datetime | None
    expires_at: datetime | None  # when its record is removed; null until it has ended


class Limits(Model):
    """What is refused beyond. Sizes in bytes."""

    mesh_formats: list[str]
    cloud_formats: list[str]
    photo_formats: list[str]
    max_json_bytes: int
    max_interact_bytes: int
    max_multipart_bytes: int
    min_photos: int
    max_photos: int
    max_photo_bytes: int
    max_archive_entries: int
    max_archive_ratio: int
    max_vertices: int
    max_faces: int
    max_frames: int
    max_gaussians: int
    max_sequence_bytes: int  # of a sequence of splats
    max_forces: int  # of one push
    max_force_groups: int  # places that swing at once
    max_displacement_bytes: int  # of one answer in voxels, vertices or Gaussians
    max_queued_jobs: int
    artifact_retention_s: float  # artefacts are kept so long [s]
    asset_retention_s: float  # uploads are kept so long after their last use [s]


class Live(Model):
    """The process answers."""

    status: Literal["ok"] = "ok"


class Locality(Model):
    """Where a group's answer is centred, and over which length it fades."""

    seed_voxel: int
    falloff_m: float


class LogLine(Model):
    """One line of a job's log."""

    id: int  # for `after`
    at: datetime  # RFC 3339, UTC
    level: Literal["info", "warning", "error"]
    message: str
    fields: dict[str, Any]


class Log(Model):
    """What happened to a job, oldest first."""

    data: "list[LogLine]"
    next_after: int  # send as `after` to go on


class Manifest(Model):
    """What a job offers."""

    job_id: str
    complete: bool  # whether the job has succeeded and nothing will be added
    artifacts: "list[Artifact]"


class Part(Model):
    """One file of an asset."""

    name: str
    sha256: str
    bytes: int


class PresetList(Model):
    """The models that jobs may name."""

    data: "list[Preset]"


class Preset(Model):
    """A trained model."""

    name: str
    bytes: int


class Problem(Model):
    """RFC 9457. Some problems have members of their own besides."""

    model_config = ConfigDict(frozen=True, extra="allow", defer_build=True)

    type: str  # urn:dynamictree:problem:CODE
    title: str
    status: int
    detail: str
    code: str
    request_id: str | None
    retryable: bool
    suggestion: str
    errors: "list[FieldError]"


class Ready(Model):
    """What the service stands on. `absent` workers mean that jobs wait; everything else that is not ok means 503."""

    status: Literal["ready", "unready"]
    database: Literal["ok", "unavailable", "full", "absent"]
    redis: Literal["ok", "unavailable", "full", "absent"]
    storage: Literal["ok", "unavailable", "full", "absent"]
    workers: Literal["ok", "unavailable", "full", "absent"]
    housekeeper: Literal["ok", "unavailable", "full", "absent"]


class ReconstructParams(Model):
    """Photos or a cloud to a mesh."""

    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = (
        None  # of a cloud, only what is inside moves: low and high corner [m], +Z up; all if unset
    )


class ReconstructRequest(Model):
    """Photos to a mesh."""

    priority: Literal["high", "normal", "low"] = "normal"  # high is begun first; with keys, one of scope high-priority
    webhook: str | None = None  # id of a webhook endpoint to tell of the end
    asset_id: str  # what POST /v1/assets gave
    preset: str = "small"  # the model, see GET /v1/presets
    seed: int = 0  # the same seed gives the same motion
    start_deadline_s: float | None = None  # aborted if no worker has begun by then [s]
    type: Literal["reconstruct"]
    params: "ReconstructParams | None" = None


class Result(Model):
    """Where the products are."""

    mesh_id: str | None  # artefact of the reconstructed mesh
    voxels_id: str | None
    spectrum_id: str | None  # for /v1/spectra and /v1/interact
    artifacts_url: str


class RetryRequest(Model):
    """How to run a job again."""

    from_stage: Literal["reconstruct", "voxelize", "diffuse", "animate"] | None = (
        None  # this stage and those after it run anew; without it, what is cached is taken
    )


class Shot(Model):
    """From where the pictures are taken."""

    side_px: int = 512
    azimuth_deg: float = 25.0  # 0 stands at -Y; grows towards +X [°]
    elevation_deg: float = 8.0  # [°]
    orbit: bool = False  # goes around once while the frames go by
    ground: bool = True  # a floor with a shadow


class Spectrum(Model):
    """A sparse voxel spectrum without its coefficients. Lengths in metres, +Z up."""

    id: str
    num_frequencies: int  # K
    frequencies_hz: list[float]
    num_voxels: int  # V
    resolution: int
    voxel_size_m: float
    origin_m: list[float]  # low corner of the grid's cube [m]
    low_m: list[float]  # low corner of the occupied voxels [m]
    high_m: list[float]  # high corner of the occupied voxels [m]
    fps: float
    num_frames: int
    period_s: float
    rest: str
    model: str
    seed: int
    wind: "Wind | None"
    units: str = "m"
    up_axis: str = "+Z"
    artifact_url: str


class Stage(Model):
    """One stage of a job."""

    name: Literal["reconstruct", "voxelize", "diffuse", "animate"]
    state: Literal["queued", "running", "succeeded", "failed", "canceled"]
    progress: float
    cached: bool  # taken from an earlier job with the same inputs
    started_at: datetime | None
    finished_at: datetime | None


class State(Model):
    """What one call ends with and the next begins with."""

    groups: "list[GroupState]"


class Try(Model):
    """One attempt to tell."""

    at: datetime  # RFC 3339, UTC
    status: int | None  # null where no answer came
    detail: str
    seconds: float


class Upload(Model):
    """A file that comes in pieces, or from an address."""

    id: str
    state: Literal[
        "receiving", "fetching", "received", "ready", "failed"
    ]  # receiving or fetching; received; ready with an asset; failed
    filename: str
    bytes_received: int
    length: int | None  # null while an address does not tell
    sha256: str | None  # as promised
    asset_id: str | None
    error: "Problem | None"
    created_at: datetime  # RFC 3339, UTC
    expires_at: datetime  # RFC 3339, UTC


class Usage(Model):
    """What the caller has, and may have; null where no key is asked for."""

    owner: str | None
    active_jobs: int
    bytes: int
    limits: dict[str, int] | None


class VoxelizeParams(Model):
    """Surface to voxels."""

    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = (
        None  # of a cloud, only what is inside moves: low and high corner [m], +Z up; all if unset
    )
    resolution: Literal[32, 64, 128, 256, 512] = 128  # voxels along the cube's side


class VoxelizeRequest(Model):
    """To the occupied voxels and their normals."""

    priority: Literal["high", "normal", "low"] = "normal"  # high is begun first; with keys, one of scope high-priority
    webhook: str | None = None  # id of a webhook endpoint to tell of the end
    asset_id: str  # what POST /v1/assets gave
    preset: str = "small"  # the model, see GET /v1/presets
    seed: int = 0  # the same seed gives the same motion
    start_deadline_s: float | None = None  # aborted if no worker has begun by then [s]
    type: Literal["voxelize"]
    params: "VoxelizeParams | None" = None


class Wind(Model):
    """The wind that the motion is generated for."""

    speed_m_s: float = 5.0  # mean speed [m/s]
    direction_deg: float = 0.0  # where it blows to, from +X towards +Y [°]
    gust: float = 0.3  # standard deviation of the speed over its mean
