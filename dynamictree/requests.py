"""All request parameters with range, default, unit and meaning; those of photos are in `photo_requests`.

The options of the command line, the bodies of HTTP requests and the cache keys of the worker are built from these
models, so a new parameter is added in one of the two modules and nowhere else. They need only pydantic.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, StringConstraints

from dynamictree.axis_names import DIRECTION_PATTERN
from dynamictree.errors import InputError
from dynamictree.photo_requests import PhotoParams
from dynamictree.request_model import LARGEST, Box, Finite, Request

MAX_FRAMES = 1_000
"""Most frames of one loop (16.7 s at 60 fps), or of a turbulent motion in a format that is written at once."""
PAPER_PERIOD_S = 100 / 24
"""Length of the paper's loop [s]."""
MAX_TURBULENT_FRAMES = 14_400
"""Most frames of a turbulent motion in a format that is written frame by frame: ten minutes at 24 fps."""
MAX_TURBULENT_FILM_FRAMES = 3_600
"""Most frames of a turbulent motion as a film, where each is rendered: two and a half minutes at 24 fps."""
TURBULENT_S = 10.0
"""Duration of a turbulent motion where the number of frames is unset [s]."""
MAX_FIRST_FRAME = 10_000_000
MAX_SEED = 2**53 - 1
"""The largest integer that every JSON reader represents exactly."""

PartNames = Annotated[
    tuple[Annotated[str, StringConstraints(min_length=1, max_length=200)], ...], Field(min_length=1, max_length=64)
]
_GltfFormat = Literal["glb", "glb-morph", "lod", "rig", "wind", "html"]
_MeshFormat = Literal["ply", "usd", "usd-skinned", "alembic", "vat", "motion"]
_SplatFormat = Literal["splat-ply", "splat", "html-splat", "usd-splat"]
Format = Literal[_GltfFormat, _MeshFormat, _SplatFormat, "png", "webp", "mp4"]
MESH_FORMATS: tuple[Format, ...] = ("ply", "glb", "png")
CLOUD_FORMATS: tuple[Format, ...] = ("splat", "png")
"""Default formats: of a mesh or photos, and of a splat or scan."""
Integrator = Literal["exact", "symplectic-euler", "explicit-euler"]
WindMode = Literal["loop", "turbulent"]
TURBULENT_FRAMES: dict[Format, int] = {
    "ply": MAX_TURBULENT_FRAMES,
    "motion": MAX_TURBULENT_FRAMES,
    "splat-ply": MAX_TURBULENT_FRAMES,
    "mp4": MAX_TURBULENT_FILM_FRAMES,
    "webp": MAX_FRAMES,
    "png": MAX_TURBULENT_FRAMES,
    "usd": MAX_FRAMES,
    "usd-splat": MAX_FRAMES,
    "alembic": MAX_FRAMES,
    "vat": MAX_FRAMES,
}
"""Most frames of a turbulent motion by format; formats that are not listed store only one period."""
Resolution = Literal[32, 64, 128, 256, 512]
UpAxis = Annotated[
    str,
    StringConstraints(max_length=80, pattern=f"^([+-]?[XYZxyz]|{DIRECTION_PATTERN})$"),
    AfterValidator(lambda axis: f"+{axis.upper()}" if len(axis) == 1 else axis.upper()),
]
"""One of +X, -X, +Y, -Y, +Z and -Z, with an optional +, or a direction."""


class Reading(Request):
    """How to read a file whose format does not say its axes or unit."""

    up_axis: UpAxis | None = Field(
        default=None,
        description="Up axis of the file: X, Y or Z, with + or - before it, or a direction in its axes such as "
        "0.17,-0.97,0.17; detected if unset",
    )
    unit_m: Finite | None = Field(
        default=None,
        ge=1e-6,
        le=1e6,
        description="Metres per unit of the file (0.01 for centimetres); detected if unset",
    )
    height_m: Finite | None = Field(
        default=None,
        gt=0,
        lt=1000,
        description="Height of the tree [m]; scales what is read, in place of unit_m; the file's if unset",
    )


class CloudParams(Request):
    """Which parts move: by default the plant as it is detected; `moving`, then `still`, then `box_m` change that."""

    box_m: Box | None = Field(
        default=None,
        description="Only what is inside moves: low and high corner [m], +Z up; all of the plant if unset. Of photos: "
        "only what is inside is the plant, in the frame of the job that had the same height_m and no box",
    )
    still: PartNames | None = Field(
        default=None,
        description="Parts that stand still: nodes and materials of a mesh, still_parts of a splat or scan; "
        "* fits any letters, ? one",
    )
    moving: PartNames | None = Field(
        default=None, description="Parts that move although they were detected as no plant, named as in still"
    )
    still_box_m: Box | None = Field(default=None, description="What is inside stands still: low and high corner [m]")
    moving_box_m: Box | None = Field(
        default=None, description="What is inside moves although it was detected as no plant: low and high corner [m]"
    )
    tree: int | None = Field(
        default=None,
        ge=1,
        le=10_000,
        description="Of a file of several trees only this one, as `trees` numbers them; if unset all, each by itself",
    )


Foliage = Annotated[Finite, Field(ge=0, le=1)]


class GridParams(Request):
    """How fine the voxel grid is. Paper section 3.3."""

    resolution: Resolution = Field(default=128, description="Voxels along the side of the cube")


class GeneratorGridParams(Request):
    """The voxel grids that a model can move."""

    resolution: Literal[128, 256, 512] = Field(default=128, description="Voxels along the side of the cube")


class ModelParams(Request):
    """Which model generates the motion, and which of its motions."""

    preset: str = Field(default="small", max_length=1024, description="The model that generates the motion")
    seed: int = Field(default=0, ge=0, le=MAX_SEED, description="The same seed gives the same motion")


@dataclass(frozen=True, kw_only=True)
class Wind:
    """The wind that a motion is generated for. Not checked when built in Python: a file may record any wind."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    speed_m_s: Annotated[Finite, Field(ge=0, le=30, description="Mean speed of the wind [m/s]")] = 5.0
    direction_deg: Annotated[
        Finite, Field(ge=-360, le=360, description="Where the wind blows to [°], from +X towards +Y")
    ] = 0.0
    gust: Annotated[Finite, Field(ge=0, le=2, description="Standard deviation of the speed over its mean")] = 0.3


class SpectrumParams(Request):
    """How the spectrum is generated. Paper section 3.4."""

    wind: Wind = Field(default_factory=Wind)
    num_steps: int | None = Field(
        default=None, ge=1, le=1000, description="Sampler steps; the number of the preset if unset"
    )
    period_s: Finite | None = Field(
        default=None,
        ge=2,
        le=30,
        description="Length of the loop [s]; if unset by the tree's height: 4.17 s up to 7 m, 16.7 s from 22 m; 4.17 s "
        "where num_frames is set or the preset is the paper's",
    )
    foliage: Foliage | None = Field(
        default=None,
        description="Foliage of the tree, which damps it: 0 bare, 1 in leaf; of a mesh as its shape tells if unset, of "
        "a splat, scan or photos in between",
    )
    wind_bands: bool = Field(
        default=False,
        description="Ask the model for winds of 1, 4, 8, 14 and 20 m/s as well: how strong each mode is in any wind",
    )


class SwingParams(Request):
    """How a tree answers forces, see docs/interaction.md."""

    damping_ratio: Finite | None = Field(
        default=None, ge=0, le=2, description="Of every mode; 1 is critical; 0.04 (bare) to 0.13 (in leaf) if unset"
    )
    foliage: Foliage | None = Field(
        default=None, description="Chooses damping and frequency: 0 bare, 1 in leaf; the spectrum's if unset"
    )
    frequency_hz: Finite | None = Field(
        default=None,
        ge=1e-3,
        le=100,
        description="Lowest natural frequency [Hz]; measured for the tree's height if unset",
    )
    mass_kg: Finite | None = Field(
        default=None, ge=1e-3, le=LARGEST, description="Mass that moves [kg]; by the tree's height if unset"
    )
    locality: Literal["none", "geodesic"] = Field(
        default="geodesic", description="What a push may reach: the whole tree, or its branch and less of what bears it"
    )
    falloff_m: Finite | None = Field(
        default=None, ge=1e-3, le=LARGEST, description="Length over which a push fades [m]; 15 % of the height if unset"
    )


class InteractParams(SwingParams):
    """How the answer of a tree to forces is computed."""

    integrator: Integrator = Field(default="exact", description="How a time step is computed")
    warp: bool = Field(
        default=False, description="Bend, do not stretch; a drag by displacement then holds its point in the bent shape"
    )


class Shot(Request):
    """Where the camera of pictures and videos stands."""

    side_px: int = Field(default=512, ge=64, le=1080, description="Side of the pictures [px]")
    azimuth_deg: Finite = Field(
        default=25.0, ge=-360, le=360, description="Direction from the tree to the camera [°]: 0 at -Y, 90 at +X"
    )
    elevation_deg: Finite = Field(
        default=8.0, ge=-30, le=80, description="Height of the camera above the horizon, seen from the tree [°]"
    )
    orbit: bool = Field(default=False, description="Go around the tree once while the frames go by")
    ground: bool = Field(default=True, description="Draw a floor with a shadow")
    grey_still: bool = Field(
        default=True,
        description="Draw what stands still because it is no plant (a pot, a table, the ground) in grey in films",
    )


class ExportParams(Request):
    """Which frames of a motion are written, and as what. Frame n shows the motion at time n · speed / fps."""

    wind_mode: WindMode = Field(
        default="loop",
        description="Motion that repeats after one period, or in turbulent wind that never repeats",
    )
    first_frame: int = Field(default=0, ge=0, le=MAX_FIRST_FRAME, description="Number of the first frame to write")
    num_frames: int | None = Field(
        default=None,
        ge=1,
        le=MAX_TURBULENT_FRAMES,
        description=f"Number of frames to write, at most {MAX_FRAMES} of a loop; if unset one period, or "
        f"{TURBULENT_S:g} s of turbulent wind",
    )
    fps: Finite = Field(
        default=24.0, ge=1, le=240, description="Frames per second; does not change the speed of the motion"
    )
    speed: Finite = Field(default=1.0, ge=0.01, le=100, description="Speed of the motion over its natural speed")
    loop: bool = Field(
        default=True, description="Refuse a number of frames that is not a whole number of periods; not if turbulent"
    )
    flutter: Finite = Field(
        default=0.0,
        ge=0,
        le=2,
        description="How far leaves turn above the spectrum, up to 8 Hz: 0 not at all, 1 as in nature by the "
        "speed of the wind. In all that is written frame by frame and in skins. Morph targets, the page and pushes "
        "have none, so by default all show one motion",
    )
    formats: (
        tuple[Annotated[Format, BeforeValidator(lambda name: "glb" if name == "glb-skinned" else name)], ...] | None
    ) = Field(
        default=None,
        min_length=1,
        max_length=16,
        description=f"Files to write; if unset {', '.join(MESH_FORMATS)} of a mesh or photos, "
        f"{', '.join(CLOUD_FORMATS)} of a splat or scan",
    )
    share: Finite = Field(default=1.0, gt=0, le=1, description="Share of a splat's Gaussians to write")
    sh_degree: int = Field(
        default=3, ge=0, le=3, description="Highest degree of a splat's spherical harmonics to write"
    )
    normals: bool = Field(default=False, description="Write normals that move, as a texture of vat")
    glb_compression: Literal["none", "meshopt"] = Field(
        default="none",
        description="Compression of glb: meshopt needs a reader of EXT_meshopt_compression",
    )
    glb_textures: Literal["source", "webp"] = Field(
        default="source",
        description="Textures of glb: PNG and JPEG as in the source, or WebP where that is smaller, which needs a "
        "reader of EXT_texture_webp",
    )
    joints: Literal[32, 64, 256] | None = Field(
        default=None, description="Joints of glb and usd-skinned, at most; all bones of the tree if unset"
    )
    shot: Shot = Field(default_factory=Shot)

    @property
    def wanted_period_s(self) -> float | None:
        """The paper's period if `num_frames` is set for a loop; None where the tree's height decides [s]."""
        return PAPER_PERIOD_S if self.wind_mode == "loop" and self.loop and self.num_frames is not None else None

    def period_frames(self, period_s: float) -> float:
        """Frames in one period of the motion."""
        return self.fps * period_s / self.speed

    def count_frames(self, period_s: float) -> int:
        """Number of frames to write.

        Raises:
            InputError: a loop is asked for and the frames are not a whole number of periods, or there are too many.
        """
        if self.wind_mode == "turbulent":
            return max(round(self.fps * TURBULENT_S), 1) if self.num_frames is None else self.num_frames
        period = self.period_frames(period_s)
        count = max(round(period), 1) if self.num_frames is None else self.num_frames
        if self.loop and not _is_whole(count / period):
            raise InputError(
                f"{count} frames at {self.fps:g} fps and speed {self.speed:g} are {count / period:.4g}"
                f" periods of {period_s:.4g} s, so the loop would jump; {_nearest_loops(count, period, MAX_FRAMES)}"
            )
        if count > MAX_FRAMES:
            subject = "one period is" if self.num_frames is None else "num_frames is"
            advice = "lower fps" if self.num_frames is None else "take wind_mode turbulent for a longer motion"
            raise InputError(f"{subject} {count} frames; at most {MAX_FRAMES} of a loop are allowed: {advice}")
        return count

    def chosen_formats(self, *, cloud: bool) -> tuple[Format, ...]:
        """Return the formats to write of a mesh or a cloud; the defaults where none are named.

        Raises:
            InputError: a format cannot store a turbulent motion, or not so many frames of it.
        """
        usual = CLOUD_FORMATS if cloud else MESH_FORMATS
        if self.wind_mode == "loop":
            return self.formats or usual
        formats = self.formats or tuple(name for name in usual if name in TURBULENT_FRAMES)
        for name in formats:
            self._require_turbulent(name)
        return formats

    def _require_turbulent(self, name: Format) -> None:
        if name not in TURBULENT_FRAMES:
            raise InputError(
                f"a file of format {name} holds one period and no turbulent motion: take {', '.join(TURBULENT_FRAMES)}"
                f", or {name} with wind_mode loop"
            )
        count = self.count_frames(1.0)
        if count > TURBULENT_FRAMES[name]:
            raise InputError(
                f"num_frames is {count}; at most {TURBULENT_FRAMES[name]} are allowed of a turbulent motion as {name}"
            )


class ReconstructParams(PhotoParams, CloudParams):
    """Parameters of a job that makes a mesh of photos or a cloud."""


class VoxelizeParams(GridParams, ReconstructParams):
    """Parameters of a job that makes the voxels of a surface."""


class DiffuseParams(SpectrumParams, ReconstructParams):
    """Parameters of a job that generates a spectrum."""


class AnimateParams(ExportParams, DiffuseParams):
    """Parameters of a job that writes a motion. The service writes png besides the formats that are asked for."""


def _is_whole(periods: float) -> bool:
    """Whether this is a whole number of periods, at least one."""
    return round(periods) >= 1 and abs(periods - round(periods)) < 1e-6


def _nearest_loops(count: int, period_frames: float, most: int) -> str:
    """Return advice with the numbers of frames next to `count`, up to `most`, that make a loop."""
    loops = [count for count in range(1, most + 1) if _is_whole(count / period_frames)]
    if not loops:
        return (
            f"no number of frames up to {most} makes a loop at this fps and speed: take fps 24, a period_s that "
            "fits, or loop=false"
        )
    below = [loop for loop in loops if loop < count][-1:]
    above = [loop for loop in loops if loop > count][:1]
    return f"{' or '.join(map(str, below + above))} frames make a loop; or take loop=false"
