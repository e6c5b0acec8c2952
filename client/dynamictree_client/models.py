"""Models of requests and responses. Made by client/generate.py; do not edit."""

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict


class Model(BaseModel):
    """Root of all. What a newer service adds is passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)


JobState = Literal["queued", "running", "canceling", "succeeded", "failed", "canceled"]
"""States of a job. The last three are final."""


class AnimateRequest(Model):
    """Generate a motion and write it as files."""

    # The model that generates the motion
    preset: str = "small"
    # The same seed gives the same motion
    seed: int = 0
    # high is begun first; with keys, one of scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # id of a webhook endpoint that gets events of this job
    webhook: str | None = None
    # which of them; those of its end if unset
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # what POST /v1/assets gave
    asset_id: str
    # your name for the job, by which lists can be filtered
    external_id: str | None = None
    # texts of yours, returned as they are
    metadata: dict[str, str] | None = None
    # where in an allowed bucket products are copied to
    destination: str | None = None
    # canceled if it has not ended by then, running or not [s]
    cancel_after_s: float | None = None
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
    # where a file is not exact, how far it is from the motion; [m] as _m says
    facts: dict[str, int | float] | None = None
    # RFC 3339, UTC
    created_at: datetime
    # RFC 3339, UTC
    expires_at: datetime


class Asset(Model):
    """An upload that was read and can be used."""

    id: str
    kind: Literal["mesh", "photos", "cloud"]
    parts: "list[Part]"
    # what was found in it, lengths in metres; `warnings` are objects with `code` and `message`, `still_parts` what
    # is not the plant and does not move: `name` and `why`, `trees` where each stands and how tall it is: `tree`
    # (its number), `x_m`, `y_m`, `z_m` and `height_m`
    summary: dict[str, str | int | float | list[float | dict[str, str | int | float]] | None]
    metadata: dict[str, str]
    # RFC 3339, UTC
    created_at: datetime
    # RFC 3339, UTC
    expires_at: datetime


class At(Model):
    """Where a force acts: exactly one of point, vertex and voxel."""

    # the nearest voxel to it
    point_m: tuple[float, float, float] | None = None
    # index into the source mesh's vertices
    vertex: int | None = None
    # row in the spectrum's coords
    voxel: int | None = None
    # spread evenly over the voxels within it
    radius_m: float = 0.0


class DeliveryList(Model):
    """A page of deliveries, newest first."""

    data: "list[Delivery]"
    next_cursor: str | None


class Delivery(Model):
    """A message for one address."""

    id: str
    # the header webhook-id; each attempt has the same
    message_id: str
    event: Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]
    job_id: str
    state: Literal["pending", "delivered", "failed"]
    tries: "list[Try]"
    # the next attempt; null once it is over
    next_at: datetime | None
    # RFC 3339, UTC
    created_at: datetime


class DiffuseRequest(Model):
    """Generate a spectrum."""

    # The model that generates the motion
    preset: str = "small"
    # The same seed gives the same motion
    seed: int = 0
    # high is begun first; with keys, one of scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # id of a webhook endpoint that gets events of this job
    webhook: str | None = None
    # which of them; those of its end if unset
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # what POST /v1/assets gave
    asset_id: str
    # your name for the job, by which lists can be filtered
    external_id: str | None = None
    # texts of yours, returned as they are
    metadata: dict[str, str] | None = None
    # where in an allowed bucket products are copied to
    destination: str | None = None
    # canceled if it has not ended by then, running or not [s]
    cancel_after_s: float | None = None
    type: Literal["diffuse"]
    params: "DiffuseParams | None" = None


class EndpointList(Model):
    """All endpoints."""

    data: "list[Endpoint]"


class Endpoint(Model):
    """A receiver of events."""

    id: str
    url: str
    events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]]
    disabled_reason: str | None
    # RFC 3339, UTC
    created_at: datetime


class EndpointRequest(Model):
    """URL and events of an endpoint."""

    # https
    url: str
    # of every job; none: only of jobs that name the endpoint
    events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] = [
        "job.succeeded",
        "job.failed",
        "job.canceled",
    ]


class FieldError(Model):
    """One field that is wrong."""

    # JSON pointer into the body, or where:name
    pointer: str
    code: str
    detail: str


class Force(Model):
    """One force on the tree."""

    kind: Literal["impulse", "drag", "wind"]
    # of an impulse or a drag; wind blows everywhere
    at: "At | None" = None
    # [N s], of an impulse
    impulse_n_s: tuple[float, float, float] | None = None
    # [N], of a drag; or displacement_m
    force_n: tuple[float, float, float] | None = None
    # [m], of a drag: where the point comes to rest, in the bent shape with warp
    displacement_m: tuple[float, float, float] | None = None
    # [m/s], of wind: one vector, or samples evenly spaced over the duration
    wind_m_s: list[float | list[float]] | None = None
    # from the first frame of this call [s]
    start_s: float = 0.0
    # [s]; unset: within one step for an impulse, to the end for others
    duration_s: float | None = None


class Group(Model):
    """One group's modal coordinates."""

    # null: the whole tree
    locality: "Locality | None"
    # [frames, K]; index = frequency bin, bin 0 is no mode and 0
    q: list[list[tuple[float, float]]]
    # [frames, n] turns of the joints from the grip's joint towards the root [rad]; null: none bends
    bend: list[list[tuple[float, float, float]]] | None


class GroupState(Model):
    """One group's coordinates: K complex numbers, index = frequency bin; bin 0 is no mode and stays 0."""

    # null: the whole tree
    locality: "Locality | None"
    q: list[tuple[float, float]]
    # [1/s]
    q_dot: list[tuple[float, float]]
    # local bends [rad], from the grip's joint towards the root
    bend: list[tuple[float, float, float]] | None = None
    # [rad/s]
    bend_rate: list[tuple[float, float, float]] | None = None


class Interact(Model):
    """Modal coordinates. With φ_k = 2c_k of the spectrum, u(p) = Σ_g w_g(p) Re Σ_k φ_k(p) q_{g,k}."""

    spectrum_id: str
    output: Literal["modal", "voxels", "vertices", "gaussians"]
    integrator: str
    dt_s: float
    num_frames: int
    # natural frequencies by bin; bin 0 is no mode and 0
    frequencies_hz: list[float]
    damping_ratio: float
    # that chose damping and frequency, 0 bare to 1 in leaf; null where neither the request nor the shape told it,
    # and the middle was taken
    foliage: float | None
    mass_kg: float
    # m of m (q̈ + 2ζω q̇ + ω² q) = Σ conj(φ)·F
    modal_mass_kg_m2: float
    groups: "list[Group]"
    # of drags by displacement, by group: with warp where they end, without it empty
    reached: "list[Reached]"
    # the next call's initial_state
    final_state: "State"


class InteractRequest(Model):
    """Forces on a tree, and the response to compute."""

    # Of every mode; 1 is critical; 0.04 (bare) to 0.13 (in leaf) if unset
    damping_ratio: float | None = None
    # Chooses damping and frequency: 0 bare, 1 in leaf; the spectrum's if unset
    foliage: float | None = None
    # Lowest natural frequency [Hz]; measured for the tree's height if unset
    frequency_hz: float | None = None
    # Mass that moves [kg]; by the tree's height if unset
    mass_kg: float | None = None
    # What a push may reach: the whole tree, or its branch and less of what bears it
    locality: Literal["none", "geodesic"] = "geodesic"
    # Length over which a push fades [m]; 15 % of the height if unset
    falloff_m: float | None = None
    # How a time step is computed
    integrator: Literal["exact", "symplectic-euler", "explicit-euler"] = "exact"
    # Bend, do not stretch; a drag by displacement then holds its point in the bent shape
    warp: bool = False
    # from a job's result
    spectrum_id: str
    forces: "list[Force] | None" = None
    # of a step, which is a frame [s]
    dt_s: float = 0.016666666666666666
    num_frames: int = 60
    # without initial_state: at rest, in equilibrium with the forces, or Davis'
    start: Literal["rest", "held", "davis"] = "rest"
    # final_state of an earlier call
    initial_state: "State | None" = None
    output: Literal["modal", "voxels", "vertices", "gaussians"] = "modal"


class JobEventData(Model):
    """The job that an event is about."""

    id: str
    type: Literal["reconstruct", "voxelize", "diffuse", "animate"]
    state: "JobState"
    asset_id: str
    retry_of: str | None
    external_id: str | None
    metadata: dict[str, str]
    error_code: str | None
    # path of the job
    url: str


class JobEvent(Model):
    """What an endpoint receives, signed."""

    type: Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]
    # RFC 3339, UTC
    timestamp: datetime
    data: "JobEventData"


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
    # mean over the stages; of photos weighed by the time that stages usually take
    progress: float
    # jobs before this one; null once it has begun
    queue_position: int | None
    # null where it is not known
    eta_s: float | None
    stages: "list[Stage]"
    # what is there so far; null before the first product
    result: "Result | None"
    error: "Problem | None"
    priority: Literal["high", "normal", "low"]
    webhook: str | None
    retry_of: str | None
    external_id: str | None
    metadata: dict[str, str]
    cancel_at: datetime | None
    destination: str | None
    # processor time of all attempts that have ended [s]
    processor_s: float
    # time of theirs on a worker with a GPU [s]
    gpu_s: float
    # RFC 3339, UTC
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    # when its record is removed; null until it has ended
    expires_at: datetime | None


class Limits(Model):
    """Limits of requests and uploads. Sizes in bytes."""

    mesh_formats: list[str]
    cloud_formats: list[str]
    photo_formats: list[str]
    # of a walk around one tree, from which photos are chosen
    film_formats: list[str]
    # what params.formats of an animate job may name
    products: "list[Product]"
    max_json_bytes: int
    max_interact_bytes: int
    max_multipart_bytes: int
    min_photos: int
    max_photos: int
    max_photo_bytes: int
    # what quality of a job on photos may be
    photo_qualities: "list[PhotoQuality]"
    max_film_bytes: int
    max_film_s: float
    # width times height
    max_film_pixels: int
    # of one asset: parts of a form, entries of a zip, or uploads
    max_files: int
    max_archive_ratio: int
    max_vertices: int
    max_faces: int
    # of a loop
    max_frames: int
    # of a motion that never repeats
    max_turbulent_frames: int
    max_gaussians: int
    # of a sequence of splats
    max_sequence_bytes: int
    # of one push
    max_forces: int
    # places that swing at once
    max_force_groups: int
    # of one answer in voxels, vertices or Gaussians
    max_displacement_bytes: int
    max_queued_jobs: int
    # lifetime of artifacts [s]
    artifact_retention_s: float
    # lifetime of uploads after their last use [s]
    asset_retention_s: float


class Link(Model):
    """A link. Whoever has it may GET the file."""

    # path and query; put the service's own address in front
    url: str
    # null where no key is required, and the path itself opens
    expires_at: datetime | None


class LinkRequest(Model):
    """Path to open without a key, and for how long."""

    # of an artifact, a spectrum, or the surface, modes, reach or points of a tree
    path: str
    # seconds until the link opens nothing
    expires_s: int = 3600


class Live(Model):
    """The process answers."""

    status: Literal["ok"] = "ok"


class Locality(Model):
    """Centre of a group's response, and the length over which it fades."""

    seed_voxel: int
    falloff_m: float


class Manifest(Model):
    """Files that a job has produced."""

    job_id: str
    # whether the job has succeeded and nothing will be added
    complete: bool
    artifacts: "list[Artifact]"


class Month(Model):
    """What attempts of jobs took that ended in one month (UTC)."""

    # 2026-11
    month: str
    attempts: int
    processor_s: float
    # during which a worker with a GPU was at work [s]
    gpu_s: float


class Ops(Model):
    """The whole service at a glance."""

    queues: "list[Queue]"
    jobs: dict[str, int]
    attempts: dict[str, int]
    workers: int
    unsent_messages: int


class Part(Model):
    """One file of an asset."""

    name: str
    sha256: str
    bytes: int


class PhotoQuality(Model):
    """What a reconstruction of one `quality` uses of its photos, and how large its splat may become."""

    quality: Literal["draft", "standard", "high"]
    # long side to which photos are reduced before features are sought
    photo_px: int
    # long side of the pictures that the splat is learned from
    splat_px: int
    max_gaussians: int
    # of the splat's colours
    sh_degree: int
    # photos that depths and splat are made of; cameras are found for all
    max_views: int
    # of training, unless splat_steps says otherwise
    num_steps: int


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

    # urn:dynamictree:problem:CODE
    type: str
    title: str
    status: int
    detail: str
    code: str
    request_id: str | None
    retryable: bool
    suggestion: str
    errors: "list[FieldError]"


class Product(Model):
    """One format that a motion can be written as."""

    format: Literal[
        "glb",
        "glb-morph",
        "lod",
        "rig",
        "wind",
        "html",
        "ply",
        "usd",
        "usd-skinned",
        "alembic",
        "vat",
        "motion",
        "splat-ply",
        "splat",
        "html-splat",
        "usd-splat",
        "png",
        "webp",
        "mp4",
    ]
    title: str
    file_name: str
    media_type: str
    shows: Literal["mesh", "splat", "pictures"]
    # parameters of an animate job that this file depends on
    options: list[str]


class Queue(Model):
    """Jobs of one queue: how many wait, for how long the oldest does, how many run."""

    name: str
    jobs: int
    oldest_s: float
    running: int


class Reached(Model):
    """How far a drag by displacement goes: less than wanted where the tree would have to stretch."""

    wanted_m: tuple[float, float, float]
    # where the point rests in the bent shape, from rest [m]
    reached_m: tuple[float, float, float]
    error_m: float
    # why it goes less far; null where it is within 1 % of the pull
    why: str | None


class Ready(Model):
    """What the service depends on. `absent` means that jobs wait; all else that is not ok means 503."""

    status: Literal["ready", "unready"]
    database: Literal["ok", "unavailable", "full", "absent"]
    redis: Literal["ok", "unavailable", "full", "absent"]
    storage: Literal["ok", "unavailable", "full", "absent"]
    workers: Literal["ok", "unavailable", "full", "absent"]
    housekeeper: Literal["ok", "unavailable", "full", "absent"]


class ReconstructParams(Model):
    """Parameters of a job that makes a mesh of photos or a cloud."""

    # Only what is inside moves: low and high corner [m], +Z up; all of the plant if unset. Of photos: only what is
    # inside is the plant, in the frame of the job that had the same height_m and no box
    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    # Parts that stand still: nodes and materials of a mesh, still_parts of a splat or scan; * fits any letters, ?
    # one
    still: list[str] | None = None
    # Parts that move although they were detected as no plant, named as in still
    moving: list[str] | None = None
    # What is inside stands still: low and high corner [m]
    still_box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    # What is inside moves although it was detected as no plant: low and high corner [m]
    moving_box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    # Of a file of several trees only this one, as `trees` numbers them; if unset all, each by itself
    tree: int | None = None
    # Of photos: how much of them is used and how fine the splat becomes; numbers are in /v1/limits
    quality: Literal["draft", "standard", "high"] = "standard"
    # Of photos: training steps of the splat; by the quality if unset
    splat_steps: int | None = None
    # Of a film: sharp frames that are taken as photos; 40 if unset
    video_frames: int | None = None
    # Of photos: the tree's height [m], which they do not show; 1 m if unset
    height_m: float | None = None
    # Of photos that show a printed marker (AprilTag 36h11): edge of its black square [m], which gives the scale; a
    # marker of the sheet in the documentation gives it without this
    marker_m: float | None = None
    # Strokes on photos that say what is the plant and what is not; all else is decided by them and by what the
    # photos show of it
    scribbles: "list[Scribble] | None" = None
    # Cut out the plant without strokes: not the ground, not what is far, but what stands in the middle of the
    # photos
    only_plant: bool = False


class ReconstructRequest(Model):
    """Reconstruct a mesh from photos."""

    # The model that generates the motion
    preset: str = "small"
    # The same seed gives the same motion
    seed: int = 0
    # high is begun first; with keys, one of scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # id of a webhook endpoint that gets events of this job
    webhook: str | None = None
    # which of them; those of its end if unset
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # what POST /v1/assets gave
    asset_id: str
    # your name for the job, by which lists can be filtered
    external_id: str | None = None
    # texts of yours, returned as they are
    metadata: dict[str, str] | None = None
    # where in an allowed bucket products are copied to
    destination: str | None = None
    # canceled if it has not ended by then, running or not [s]
    cancel_after_s: float | None = None
    type: Literal["reconstruct"]
    params: "ReconstructParams | None" = None


class Result(Model):
    """Ids of the products."""

    # artefact of the reconstructed mesh
    mesh_id: str | None
    voxels_id: str | None
    # for /v1/spectra and /v1/interact
    spectrum_id: str | None
    # how what was uploaded was read, as in the asset's `summary`: height, up axis, unit, `warnings`, `still_parts`;
    # null once the asset's record is removed
    source: dict[str, str | int | float | list[float | dict[str, str | int | float]] | None] | None
    # of photos: what makes the reconstruction doubtful, and what to do
    warnings: list[str]
    artifacts_url: str


class Scribble(Model):
    """A stroke on a photo, or a click, that says what is seen under it."""

    # The photo's name, as in cameras.json
    photo: str
    # Whether the plant is under it, or something else
    plant: bool
    # Places along the stroke, from left and from top, as shares of the photo's width and height
    points: list[tuple[float, float]]


class Shot(Model):
    """Where the camera of pictures and videos stands."""

    # Side of the pictures [px]
    side_px: int = 512
    # Direction from the tree to the camera [°]: 0 at -Y, 90 at +X
    azimuth_deg: float = 25.0
    # Height of the camera above the horizon, seen from the tree [°]
    elevation_deg: float = 8.0
    # Go around the tree once while the frames go by
    orbit: bool = False
    # Draw a floor with a shadow
    ground: bool = True
    # Draw what stands still because it is no plant (a pot, a table, the ground) in grey in films
    grey_still: bool = True


class Spectrum(Model):
    """A sparse voxel spectrum without its coefficients. Lengths in metres, +Z up."""

    id: str
    # K
    num_frequencies: int
    frequencies_hz: list[float]
    # V
    num_voxels: int
    resolution: int
    voxel_size_m: float
    # low corner of the grid's cube [m]
    origin_m: list[float]
    # low corner of the occupied voxels [m]
    low_m: list[float]
    # high corner of the occupied voxels [m]
    high_m: list[float]
    fps: float
    num_frames: int
    period_s: float
    rest: str
    model: str
    seed: int
    wind: "Wind | None"
    # 0 bare, 1 in leaf; null where the shape did not tell
    foliage: float | None
    # null unless the job asked for them
    wind_bands: "WindBands | None"
    units: str = "m"
    up_axis: str = "+Z"
    artifact_url: str


class Stage(Model):
    """One stage of a job."""

    name: Literal["reconstruct", "voxelize", "diffuse", "animate"]
    state: Literal["queued", "running", "succeeded", "failed", "canceled"]
    progress: float
    # taken from an earlier job with the same inputs
    cached: bool
    # earlier by the work of attempts that the stage continues
    started_at: datetime | None
    finished_at: datetime | None


class State(Model):
    """State at the end of one call, from which the next call continues."""

    groups: "list[GroupState]"


class Try(Model):
    """One delivery attempt."""

    # RFC 3339, UTC
    at: datetime
    # null where no answer came
    status: int | None
    detail: str
    seconds: float


class TurbulentWind(Model):
    """Coordinates of the bins in wind that never repeats, as sums of cosines. docs/engines.md evaluates them."""

    spectrum_id: str
    seed: int
    # mean speed, direction and gust
    wind: "Wind"
    # lowest, of a tree of this height
    natural_frequency_hz: float
    # of a tree with this foliage
    damping_ratio: float
    # of the turbulence at the top of the tree
    length_scale_m: float
    # of the K bins; bin 0 is the lean
    frequencies_hz: list[float]
    # half-width of each bin's line at half of its power
    bandwidth_hz: list[float]
    # [K - 1][J] from bin 1
    partial_hz: list[list[float]]
    # [K - 1][J] from bin 1
    partial_phase_rad: list[list[float]]
    # factor on the coordinates of bins 1 to K - 1
    strength: "Wave"
    # coordinate of bin 0, which is real
    lean: "Wave"
    # factors on the coordinates by mean speed: by the model where the job asked for wind_bands, else a power law
    bands: "WindBands"
    # of the whole displacement about the vertical, from +X towards +Y
    turn_rad: "Wave"


class UploadPart(Model):
    """One piece of an upload, to PUT to object storage."""

    offset: int
    bytes: int
    url: str


class UploadParts(Model):
    """The pieces that an upload lacks."""

    parts: "list[UploadPart]"
    # RFC 3339, UTC
    expires_at: datetime


class Upload(Model):
    """A file that comes in pieces, or from an address."""

    id: str
    # receiving or fetching; received; ready with an asset; failed
    state: Literal["receiving", "fetching", "received", "ready", "failed"]
    filename: str
    bytes_received: int
    # null while an address does not tell
    length: int | None
    # as promised
    sha256: str | None
    asset_id: str | None
    error: "Problem | None"
    # RFC 3339, UTC
    created_at: datetime
    # RFC 3339, UTC
    expires_at: datetime


class Usage(Model):
    """What the caller has, and may have; null where no key is asked for."""

    owner: str | None
    active_jobs: int
    bytes: int
    limits: dict[str, int] | None
    # newest first, at most 12
    months: "list[Month]"


class VoxelizeRequest(Model):
    """Compute the occupied voxels and their normals."""

    # The model that generates the motion
    preset: str = "small"
    # The same seed gives the same motion
    seed: int = 0
    # high is begun first; with keys, one of scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # id of a webhook endpoint that gets events of this job
    webhook: str | None = None
    # which of them; those of its end if unset
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # what POST /v1/assets gave
    asset_id: str
    # your name for the job, by which lists can be filtered
    external_id: str | None = None
    # texts of yours, returned as they are
    metadata: dict[str, str] | None = None
    # where in an allowed bucket products are copied to
    destination: str | None = None
    # canceled if it has not ended by then, running or not [s]
    cancel_after_s: float | None = None
    type: Literal["voxelize"]
    params: "VoxelizeParams | None" = None


class Wave(Model):
    """mean + limit · tanh(Σ_m amplitude_m cos(2π frequency_hz_m t + phase_rad_m) / limit)."""

    mean: float
    limit: float
    frequency_hz: list[float]
    amplitude: list[float]
    phase_rad: list[float]


class Wind(Model):
    """The wind that a motion is generated for. Not checked when built in Python: a file may record any wind."""

    # Mean speed of the wind [m/s]
    speed_m_s: float = 5.0
    # Where the wind blows to [°], from +X towards +Y
    direction_deg: float = 0.0
    # Standard deviation of the speed over its mean
    gust: float = 0.3


class WindBands(Model):
    """How much stronger each mode is in other winds. Between two speeds the gain is linear in the drag.  The drag is
    speed^1.4 up to 12 m/s, and in proportion to the speed above.
    """

    # [B] rising from 0; above the last the gains stay
    speeds_m_s: list[float]
    # [B][K] over the size in the spectrum's own wind; bin 0 is the lean
    gains: list[list[float]]


class DiffuseParams(ReconstructParams):
    """Parameters of a job that generates a spectrum."""

    wind: "Wind | None" = None
    # Sampler steps; the number of the preset if unset
    num_steps: int | None = None
    # Length of the loop [s]; if unset by the tree's height: 4.17 s up to 7 m, 16.7 s from 22 m; 4.17 s where
    # num_frames is set or the preset is the paper's
    period_s: float | None = None
    # Foliage of the tree, which damps it: 0 bare, 1 in leaf; of a mesh as its shape tells if unset, of a splat,
    # scan or photos in between
    foliage: float | None = None
    # Ask the model for winds of 1, 4, 8, 14 and 20 m/s as well: how strong each mode is in any wind
    wind_bands: bool = False


class EndpointWithSecret(Endpoint):
    """An endpoint with its secret, which is returned only once."""

    # whsec_ and base64: the key of HMAC-SHA256 over id.timestamp.body
    secret: str


class VoxelizeParams(ReconstructParams):
    """Parameters of a job that makes the voxels of a surface."""

    # Voxels along the side of the cube
    resolution: Literal[32, 64, 128, 256, 512] = 128


class AnimateParams(DiffuseParams):
    """Parameters of a job that writes a motion. The service writes png besides the formats that are asked for."""

    # Motion that repeats after one period, or in turbulent wind that never repeats
    wind_mode: Literal["loop", "turbulent"] = "loop"
    # Number of the first frame to write
    first_frame: int = 0
    # Number of frames to write, at most 1000 of a loop; if unset one period, or 10 s of turbulent wind
    num_frames: int | None = None
    # Frames per second; does not change the speed of the motion
    fps: float = 24.0
    # Speed of the motion over its natural speed
    speed: float = 1.0
    # Refuse a number of frames that is not a whole number of periods; not if turbulent
    loop: bool = True
    # How far leaves turn above the spectrum, up to 8 Hz: 0 not at all, 1 as in nature by the speed of the wind. In
    # all that is written frame by frame and in skins. Morph targets, the page and pushes have none, so by default
    # all show one motion
    flutter: float = 0.0
    # Files to write; if unset ply, glb, png of a mesh or photos, splat, png of a splat or scan
    formats: (
        list[
            Literal[
                "glb",
                "glb-morph",
                "lod",
                "rig",
                "wind",
                "html",
                "ply",
                "usd",
                "usd-skinned",
                "alembic",
                "vat",
                "motion",
                "splat-ply",
                "splat",
                "html-splat",
                "usd-splat",
                "png",
                "webp",
                "mp4",
            ]
        ]
        | None
    ) = None
    # Share of a splat's Gaussians to write
    share: float = 1.0
    # Highest degree of a splat's spherical harmonics to write
    sh_degree: int = 3
    # Write normals that move, as a texture of vat
    normals: bool = False
    # Compression of glb: meshopt needs a reader of EXT_meshopt_compression
    glb_compression: Literal["none", "meshopt"] = "none"
    # Textures of glb: PNG and JPEG as in the source, or WebP where that is smaller, which needs a reader of
    # EXT_texture_webp
    glb_textures: Literal["source", "webp"] = "source"
    # Joints of glb and usd-skinned, at most; all bones of the tree if unset
    joints: Literal[32, 64, 256] | None = None
    shot: "Shot | None" = None
