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

    # Model that generates the motion
    preset: str = "small"
    # Random seed; the same seed gives the same motion
    seed: int = 0
    # high runs first; if keys are required, it needs the scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # Id of a webhook endpoint that receives events of this job
    webhook: str | None = None
    # Events to send; by default those of the job's end
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # Id that POST /v1/assets returned
    asset_id: str
    # Your name for the job, for filtering lists
    external_id: str | None = None
    # Your texts, returned unchanged
    metadata: dict[str, str] | None = None
    # URL in an allowed bucket to which products are copied
    destination: str | None = None
    # Time after which the job is canceled unless it has ended [s]
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
    # Errors of the file against the motion; names with _m are in metres
    facts: dict[str, int | float] | None = None
    # Time (RFC 3339, UTC)
    created_at: datetime
    # Time (RFC 3339, UTC)
    expires_at: datetime


class Asset(Model):
    """An asset: files that were read and that jobs can use."""

    id: str
    kind: Literal["mesh", "photos", "cloud"]
    parts: "list[Part]"
    # Content of the files, lengths in metres; `warnings` are objects with `code` and `message`, `still_parts`
    # (parts that are no plant and do not move) with `name` and `why`, `trees` with `tree` (number), foot `x_m`,
    # `y_m`, `z_m` and `height_m`
    summary: dict[str, str | int | float | list[float | dict[str, str | int | float]] | None]
    metadata: dict[str, str]
    # Time (RFC 3339, UTC)
    created_at: datetime
    # Time (RFC 3339, UTC)
    expires_at: datetime


class At(Model):
    """Place of a force: exactly one of point, vertex and voxel."""

    # Point; the nearest voxel is used [m]
    point_m: tuple[float, float, float] | None = None
    # Index of a vertex of the source mesh
    vertex: int | None = None
    # Row of a voxel in the spectrum's coords
    voxel: int | None = None
    # Radius over which the force is spread [m]
    radius_m: float = 0.0


class DeliveryList(Model):
    """A page of deliveries, newest first."""

    data: "list[Delivery]"
    next_cursor: str | None


class Delivery(Model):
    """A message to one endpoint."""

    id: str
    # Header webhook-id, the same in every attempt
    message_id: str
    event: Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]
    job_id: str
    state: Literal["pending", "delivered", "failed"]
    tries: "list[Try]"
    # Time of the next attempt; null if there is none
    next_at: datetime | None
    # Time (RFC 3339, UTC)
    created_at: datetime


class DiffuseRequest(Model):
    """Generate a spectrum."""

    # Model that generates the motion
    preset: str = "small"
    # Random seed; the same seed gives the same motion
    seed: int = 0
    # high runs first; if keys are required, it needs the scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # Id of a webhook endpoint that receives events of this job
    webhook: str | None = None
    # Events to send; by default those of the job's end
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # Id that POST /v1/assets returned
    asset_id: str
    # Your name for the job, for filtering lists
    external_id: str | None = None
    # Your texts, returned unchanged
    metadata: dict[str, str] | None = None
    # URL in an allowed bucket to which products are copied
    destination: str | None = None
    # Time after which the job is canceled unless it has ended [s]
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
    # Time (RFC 3339, UTC)
    created_at: datetime


class EndpointRequest(Model):
    """URL and events of an endpoint."""

    # HTTPS address
    url: str
    # Events of all jobs; if empty, of jobs that name the endpoint
    events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] = [
        "job.succeeded",
        "job.failed",
        "job.canceled",
    ]


class FieldError(Model):
    """One invalid field."""

    # JSON pointer into the body, or location:name
    pointer: str
    code: str
    detail: str


class Force(Model):
    """One force on the tree."""

    kind: Literal["impulse", "drag", "wind"]
    # Place of an impulse or a drag; wind acts everywhere
    at: "At | None" = None
    # Impulse [N s]; only with kind impulse
    impulse_n_s: tuple[float, float, float] | None = None
    # Force of a drag [N]; alternative to displacement_m
    force_n: tuple[float, float, float] | None = None
    # Displacement of the dragged point at rest [m]
    displacement_m: tuple[float, float, float] | None = None
    # Velocity of wind [m/s]: one vector, or evenly spaced samples over the duration
    wind_m_s: list[float | list[float]] | None = None
    # Start, relative to this call's first frame [s]
    start_s: float = 0.0
    # Duration [s]; if unset, one step for an impulse, else until the end
    duration_s: float | None = None


class Group(Model):
    """One group's modal coordinates."""

    # Locality of the group; null is the whole tree
    locality: "Locality | None"
    # Coordinates [frames, K] by frequency bin; bin 0 is always 0
    q: list[list[tuple[float, float]]]
    # Bends of joints from the grip towards the root, [frames, n] vectors [rad]; null if none bends
    bend: list[list[tuple[float, float, float]]] | None


class GroupState(Model):
    """One group's coordinates: K complex numbers, index = frequency bin; bin 0 is no mode and stays 0."""

    # Locality of the group; null is the whole tree
    locality: "Locality | None"
    q: list[tuple[float, float]]
    # Rates of q [1/s]
    q_dot: list[tuple[float, float]]
    # Local bends [rad], from the grip's joint towards the root
    bend: list[tuple[float, float, float]] | None = None
    # Rates of bend [rad/s]
    bend_rate: list[tuple[float, float, float]] | None = None


class Interact(Model):
    """Modal coordinates. With φ_k = 2c_k of the spectrum, u(p) = Σ_g w_g(p) Re Σ_k φ_k(p) q_{g,k}."""

    spectrum_id: str
    output: Literal["modal", "voxels", "vertices", "gaussians"]
    integrator: str
    dt_s: float
    num_frames: int
    # Natural frequencies by bin [Hz]; bin 0 is always 0
    frequencies_hz: list[float]
    damping_ratio: float
    # Foliage, which sets damping and frequency, 0 (bare) to 1 (in leaf); null if neither request nor shape states
    # it, and the middle is used
    foliage: float | None
    mass_kg: float
    # m in m (q̈ + 2ζω q̇ + ω² q) = Σ conj(φ)·F
    modal_mass_kg_m2: float
    groups: "list[Group]"
    # Result of each drag by displacement, by group
    reached: "list[Reached]"
    # The initial_state of the next call
    final_state: "State"


class InteractRequest(Model):
    """Forces on a tree, and the response to compute."""

    # Damping ratio of all modes; by default 0.04 (bare) to 0.13 (in leaf)
    damping_ratio: float | None = None
    # Foliage for damping and frequency: 0 bare, 1 in leaf; by default the spectrum's
    foliage: float | None = None
    # Lowest natural frequency [Hz]; by default that of real trees of this height
    frequency_hz: float | None = None
    # Moving mass [kg]; by default from the tree's height
    mass_kg: float | None = None
    # Reach of a push: the whole tree, or its branch and, less, what carries it
    locality: Literal["none", "geodesic"] = "geodesic"
    # Distance over which a push fades [m]; default: 15 % of the height
    falloff_m: float | None = None
    # Method of time integration
    integrator: Literal["exact", "symplectic-euler", "explicit-euler"] = "exact"
    # The spectrum_id in a job's result
    spectrum_id: str
    forces: "list[Force] | None" = None
    # Time step, which is also the time of a frame [s]
    dt_s: float = 0.016666666666666666
    num_frames: int = 60
    # Start without initial_state: at rest, in equilibrium (held), or after Davis et al.
    start: Literal["rest", "held", "davis"] = "rest"
    # The final_state of an earlier call
    initial_state: "State | None" = None
    output: Literal["modal", "voxels", "vertices", "gaussians"] = "modal"
    # Without effect, and never false: the tree always bends
    warp: bool | None = None


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
    # Path of the job
    url: str


class JobEvent(Model):
    """Body of a signed event."""

    type: Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]
    # Time (RFC 3339, UTC)
    timestamp: datetime
    data: "JobEventData"


class JobList(Model):
    """A page of jobs, newest first."""

    data: "list[Job]"
    next_cursor: str | None


class Job(Model):
    """Current state of a job."""

    id: str
    type: Literal["reconstruct", "voxelize", "diffuse", "animate"]
    state: "JobState"
    asset_id: str
    preset: str
    seed: int
    params: dict[str, Any]
    attempt: int
    # Mean over the stages; of photos, weighted by typical durations
    progress: float
    # Number of jobs before this one; null once started
    queue_position: int | None
    # Remaining time [s]; null if unknown
    eta_s: float | None
    stages: "list[Stage]"
    # Products so far; null before the first
    result: "Result | None"
    error: "Problem | None"
    priority: Literal["high", "normal", "low"]
    webhook: str | None
    retry_of: str | None
    external_id: str | None
    metadata: dict[str, str]
    cancel_at: datetime | None
    destination: str | None
    # CPU time of all ended attempts [s]
    processor_s: float
    # Run time of ended attempts on a GPU worker [s]
    gpu_s: float
    # Time (RFC 3339, UTC)
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    # Time at which its record is deleted; null until it ends
    expires_at: datetime | None


class Limits(Model):
    """Limits of requests and uploads. Sizes in bytes."""

    mesh_formats: list[str]
    cloud_formats: list[str]
    photo_formats: list[str]
    # Formats of films, from which photos are chosen
    film_formats: list[str]
    # Values of params.formats of an animate job
    products: "list[Product]"
    max_json_bytes: int
    max_interact_bytes: int
    max_multipart_bytes: int
    min_photos: int
    max_photos: int
    max_photo_bytes: int
    # Values of quality of a job with photos
    photo_qualities: "list[PhotoQuality]"
    max_film_bytes: int
    max_film_s: float
    # Largest width times height [px]
    max_film_pixels: int
    # Files per asset: form parts, zip entries or uploads
    max_files: int
    max_archive_ratio: int
    max_vertices: int
    max_faces: int
    # Frames of a loop
    max_frames: int
    # Frames of a turbulent motion
    max_turbulent_frames: int
    max_gaussians: int
    # Size of a sequence of splats [bytes]
    max_sequence_bytes: int
    # Forces per request
    max_forces: int
    # Groups of forces (places) per request
    max_force_groups: int
    # Size of a binary response of /v1/interact [bytes]
    max_displacement_bytes: int
    max_queued_jobs: int
    # Lifetime of artifacts [s]
    artifact_retention_s: float
    # Lifetime of assets after their last use [s]
    asset_retention_s: float


class Link(Model):
    """A signed link, with which anyone can GET the file."""

    # Path and query, relative to the service's address
    url: str
    # Null if no key is required; then the path suffices
    expires_at: datetime | None


class LinkRequest(Model):
    """Path to open without a key, and for how long."""

    # Path of an artifact, a spectrum, or a tree's surface, modes, reach or points
    path: str
    # Lifetime of the link [s]
    expires_s: int = 3600


class Live(Model):
    """Liveness of the process."""

    status: Literal["ok"] = "ok"


class Locality(Model):
    """Centre of a group's response, and the length over which it fades."""

    seed_voxel: int
    falloff_m: float


class Manifest(Model):
    """Files that a job has produced."""

    job_id: str
    # True if the job has succeeded and adds no more files
    complete: bool
    artifacts: "list[Artifact]"


class Month(Model):
    """Resource use of attempts of jobs that ended in one month (UTC)."""

    # Month (UTC) as YYYY-MM
    month: str
    attempts: int
    processor_s: float
    # Run time on workers with a GPU [s]
    gpu_s: float


class Ops(Model):
    """State of the whole service."""

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
    """Limits of a reconstruction of one `quality`: sizes of photos and splat."""

    quality: Literal["draft", "standard", "high"]
    # Long side of photos for feature detection [px]
    photo_px: int
    # Long side of photos for training the splat [px]
    splat_px: int
    max_gaussians: int
    # Degree of the splat's spherical harmonics
    sh_degree: int
    # Largest number of photos for depth maps and splat
    max_views: int
    # Training steps if splat_steps is unset
    num_steps: int


class PresetList(Model):
    """The models that jobs can use."""

    data: "list[Preset]"


class Preset(Model):
    """A trained model."""

    name: str
    bytes: int


class Problem(Model):
    """Problem object (RFC 9457). Some problems have additional members."""

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
    """One file format of a motion."""

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
    # Parameters of an animate job that affect this file
    options: list[str]


class Queue(Model):
    """Jobs of one queue: number waiting, age of the oldest, number running."""

    name: str
    jobs: int
    oldest_s: float
    running: int


class Reached(Model):
    """Result of a drag by displacement, which falls short where the tree would have to stretch."""

    wanted_m: tuple[float, float, float]
    # Displacement of the point in the bent shape [m]
    reached_m: tuple[float, float, float]
    error_m: float
    # Reason for a shortfall; null if below 1 % of the pull
    why: str | None


class Ready(Model):
    """State of the parts; `reader` reads uploads, absent before it starts. Any state but ok and absent is 503."""

    status: Literal["ready", "unready"]
    database: Literal["ok", "unavailable", "full", "absent"]
    redis: Literal["ok", "unavailable", "full", "absent"]
    storage: Literal["ok", "unavailable", "full", "absent"]
    reader: Literal["ok", "unavailable", "full", "absent"]
    workers: Literal["ok", "unavailable", "full", "absent"]
    housekeeper: Literal["ok", "unavailable", "full", "absent"]


class ReconstructParams(Model):
    """Parameters of a job that makes a mesh from photos or a cloud."""

    # Box outside which nothing moves: low and high corner [m], +Z up; by default none. For photos: box around the
    # plant, in the frame of a job with the same height_m and no box
    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    # Parts that stand still: nodes and materials of a mesh, still_parts of a splat or scan; * matches any
    # characters, ? one
    still: list[str] | None = None
    # Parts that move although they were detected as no plant; names as in still
    moving: list[str] | None = None
    # Box in which all stands still: low and high corner [m]
    still_box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    # Box in which all moves, also what is detected as no plant: low and high corner [m]
    moving_box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    # Number of the only tree to use, as in `trees`; by default all trees of a file, each by itself
    tree: int | None = None
    # For photos: sizes of photos and splat; the numbers are in /v1/limits
    quality: Literal["draft", "standard", "high"] = "standard"
    # For photos: training steps of the splat; by default the quality's
    splat_steps: int | None = None
    # For a film: number of sharp frames used as photos; by default 40
    video_frames: int | None = None
    # For photos, which show no scale: height of the tree [m]; by default 1 m
    height_m: float | None = None
    # For photos of a printed marker (AprilTag 36h11): edge of its black square [m], which sets the scale; markers
    # of the sheet in the documentation need no edge
    marker_m: float | None = None
    # Strokes on photos that mark what is the plant and what is not; the rest is decided from these and from its
    # look in the photos
    scribbles: "list[Scribble] | None" = None
    # Cut out the plant without strokes: the object in the middle of the photos, without ground and background
    only_plant: bool = False


class ReconstructRequest(Model):
    """Reconstruct a mesh from photos or a cloud."""

    # Model that generates the motion
    preset: str = "small"
    # Random seed; the same seed gives the same motion
    seed: int = 0
    # high runs first; if keys are required, it needs the scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # Id of a webhook endpoint that receives events of this job
    webhook: str | None = None
    # Events to send; by default those of the job's end
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # Id that POST /v1/assets returned
    asset_id: str
    # Your name for the job, for filtering lists
    external_id: str | None = None
    # Your texts, returned unchanged
    metadata: dict[str, str] | None = None
    # URL in an allowed bucket to which products are copied
    destination: str | None = None
    # Time after which the job is canceled unless it has ended [s]
    cancel_after_s: float | None = None
    type: Literal["reconstruct"]
    params: "ReconstructParams | None" = None


class Result(Model):
    """Ids of the products."""

    # Artifact of the reconstructed mesh
    mesh_id: str | None
    voxels_id: str | None
    # Id for /v1/spectra and /v1/interact
    spectrum_id: str | None
    # How the upload was read, as in the asset's `summary`: height, up axis, unit, `warnings`, `still_parts`; null
    # once the asset's record is deleted
    source: dict[str, str | int | float | list[float | dict[str, str | int | float]] | None] | None
    # Warnings about a reconstruction, with advice
    warnings: list[str]
    artifacts_url: str


class Scribble(Model):
    """A stroke or click on a photo that marks the plant or something else."""

    # The photo's name, as in cameras.json
    photo: str
    # True if the stroke marks the plant, false for anything else
    plant: bool
    # Points along the stroke, from left and from top, as shares of the photo's width and height
    points: list[tuple[float, float]]


class Shot(Model):
    """Camera of pictures and videos."""

    # Side length of pictures [px]
    side_px: int = 512
    # Direction from the tree to the camera [°]: 0 at -Y, 90 at +X
    azimuth_deg: float = 25.0
    # Elevation of the camera above the horizon [°]
    elevation_deg: float = 8.0
    # Move the camera around the tree once
    orbit: bool = False
    # Draw a floor with a shadow
    ground: bool = True
    # In films, draw still parts that are no plant (a pot, a table, the ground) in grey
    grey_still: bool = True


class Spectrum(Model):
    """A sparse voxel spectrum without its coefficients. Lengths in metres, +Z up."""

    id: str
    # Number K of frequency bins
    num_frequencies: int
    frequencies_hz: list[float]
    # Number V of occupied voxels
    num_voxels: int
    resolution: int
    voxel_size_m: float
    # Low corner of the grid's cube [m]
    origin_m: list[float]
    # Low corner of the occupied voxels [m]
    low_m: list[float]
    # High corner of the occupied voxels [m]
    high_m: list[float]
    fps: float
    num_frames: int
    period_s: float
    rest: str
    model: str
    seed: int
    wind: "Wind | None"
    # Foliage, 0 (bare) to 1 (in leaf); null if unknown
    foliage: float | None
    # Null unless the job requested them
    wind_bands: "WindBands | None"
    units: str = "m"
    up_axis: str = "+Z"
    artifact_url: str


class Stage(Model):
    """One stage of a job."""

    name: Literal["reconstruct", "voxelize", "diffuse", "animate"]
    state: Literal["queued", "running", "succeeded", "failed", "canceled"]
    progress: float
    # True if taken from an earlier job with the same inputs
    cached: bool
    # Start, moved back by the work of earlier attempts
    started_at: datetime | None
    finished_at: datetime | None


class State(Model):
    """State at the end of one call, from which the next call continues."""

    groups: "list[GroupState]"


class Try(Model):
    """One delivery attempt."""

    # Time (RFC 3339, UTC)
    at: datetime
    # HTTP status; null without a response
    status: int | None
    detail: str
    seconds: float


class TurbulentWind(Model):
    """Coordinates of the bins in wind that never repeats, as sums of cosines. See docs/engines.md."""

    spectrum_id: str
    seed: int
    # Mean speed, direction and gust
    wind: "Wind"
    # Lowest frequency of a tree of this height [Hz]
    natural_frequency_hz: float
    # Damping ratio of a tree with this foliage
    damping_ratio: float
    # Turbulence length scale at the top of the tree [m]
    length_scale_m: float
    # Frequencies of the K bins [Hz]; bin 0 is the lean
    frequencies_hz: list[float]
    # Half width at half maximum of each bin's line [Hz]
    bandwidth_hz: list[float]
    # Frequencies of partials [K - 1][J], from bin 1 [Hz]
    partial_hz: list[list[float]]
    # Phases of partials [K - 1][J], from bin 1 [rad]
    partial_phase_rad: list[list[float]]
    # Factor on the coordinates of bins 1 to K - 1
    strength: "Wave"
    # Coordinate of bin 0, which is real
    lean: "Wave"
    # Factors on the coordinates by mean speed: from the model if the job requested wind_bands, else a power law
    bands: "WindBands"
    # Rotation of all displacements about +Z, from +X towards +Y
    turn_rad: "Wave"


class UploadPart(Model):
    """One part of an upload, to PUT to object storage."""

    offset: int
    bytes: int
    url: str


class UploadParts(Model):
    """The missing parts of an upload."""

    parts: "list[UploadPart]"
    # Time (RFC 3339, UTC)
    expires_at: datetime


class Upload(Model):
    """A file that is received in parts, or fetched from a URL."""

    id: str
    # receiving or fetching, received, ready (has an asset), failed
    state: Literal["receiving", "fetching", "received", "ready", "failed"]
    filename: str
    bytes_received: int
    # Size of the file [bytes]; null while unknown
    length: int | None
    # Announced hash of the file
    sha256: str | None
    asset_id: str | None
    error: "Problem | None"
    # Time (RFC 3339, UTC)
    created_at: datetime
    # Time (RFC 3339, UTC)
    expires_at: datetime


class Usage(Model):
    """Resource use and limits of the caller; null if no key is required."""

    owner: str | None
    active_jobs: int
    bytes: int
    limits: dict[str, int] | None
    # Up to 12 months, newest first
    months: "list[Month]"


class VoxelizeRequest(Model):
    """Compute the occupied voxels and their normals."""

    # Model that generates the motion
    preset: str = "small"
    # Random seed; the same seed gives the same motion
    seed: int = 0
    # high runs first; if keys are required, it needs the scope high-priority
    priority: Literal["high", "normal", "low"] = "normal"
    # Id of a webhook endpoint that receives events of this job
    webhook: str | None = None
    # Events to send; by default those of the job's end
    webhook_events: list[Literal["job.first-artifact", "job.succeeded", "job.failed", "job.canceled"]] | None = None
    # Id that POST /v1/assets returned
    asset_id: str
    # Your name for the job, for filtering lists
    external_id: str | None = None
    # Your texts, returned unchanged
    metadata: dict[str, str] | None = None
    # URL in an allowed bucket to which products are copied
    destination: str | None = None
    # Time after which the job is canceled unless it has ended [s]
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
    """Wind for which a motion is generated. Python does not check the ranges: a file may record any wind."""

    # Mean speed of the wind [m/s]
    speed_m_s: float = 5.0
    # Direction to which the wind blows [°], from +X towards +Y
    direction_deg: float = 0.0
    # Standard deviation of speed / mean speed
    gust: float = 0.3


class WindBands(Model):
    """Gain of each mode by wind speed. Between two speeds, the gain is linear in the drag.  The drag is speed^1.4 up
    to 12 m/s, and proportional to the speed above.
    """

    # Mean speeds [B], from 0 upward; gains are constant above the last
    speeds_m_s: list[float]
    # Gains [B][K] relative to the spectrum's own wind; bin 0 is the lean
    gains: list[list[float]]


class DiffuseParams(ReconstructParams):
    """Parameters of a job that generates a spectrum."""

    wind: "Wind | None" = None
    # Number of sampler steps; by default the preset's
    num_steps: int | None = None
    # Length of the loop [s]; by default from the height: 4.17 s up to 7 m, 16.7 s from 22 m; 4.17 s if num_frames
    # is set or the preset is the paper's
    period_s: float | None = None
    # Foliage, which damps the motion: 0 (bare) to 1 (in leaf); by default as a mesh's shape shows, in between for a
    # splat, scan or photos
    foliage: float | None = None
    # Also generate winds of 1, 4, 8, 14 and 20 m/s, for the strength of each mode in any wind
    wind_bands: bool = False


class EndpointWithSecret(Endpoint):
    """An endpoint with its secret, which is returned only once."""

    # Key of HMAC-SHA256 over id.timestamp.body, as whsec_ and base64
    secret: str


class VoxelizeParams(ReconstructParams):
    """Parameters of a job that voxelizes a surface."""

    # Number of voxels per side of the cube
    resolution: Literal[32, 64, 128, 256, 512] = 128


class AnimateParams(DiffuseParams):
    """Parameters of a job that writes a motion. The service always writes png too."""

    # Motion that repeats after one period (loop), or turbulent wind that never repeats
    wind_mode: Literal["loop", "turbulent"] = "loop"
    # Number of the first frame to write
    first_frame: int = 0
    # Number of frames to write, at most 1000 of a loop; by default one period, or 10 s of turbulent wind
    num_frames: int | None = None
    # Frames per second, which do not change the speed of the motion
    fps: float = 24.0
    # Speed of the motion / natural speed
    speed: float = 1.0
    # Refuse frames that are not a whole number of periods, except in turbulent wind
    loop: bool = True
    # Flutter of leaves at frequencies above the spectrum's, up to 8 Hz: 0 is none, 1 as in nature at this wind
    # speed. Morph targets and `rig` have none
    flutter: float = 1.0
    # Files to write; by default ply, glb, png of a mesh or photos, splat, png of a splat or scan
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
    # Write moving normals as a texture of vat
    normals: bool = False
    # Compression of glb; meshopt needs a reader of EXT_meshopt_compression
    glb_compression: Literal["none", "meshopt"] = "none"
    # Textures of glb: those of the source, or WebP where that is smaller, which needs a reader of EXT_texture_webp
    glb_textures: Literal["source", "webp"] = "source"
    # Largest number of joints of glb and usd-skinned; by default all bones of the tree
    joints: Literal[32, 64, 256] | None = None
    shot: "Shot | None" = None
