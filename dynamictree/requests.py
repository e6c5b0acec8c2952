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
from dynamictree.request_model import LARGEST, Box, Finite, Pattern, Request, Share

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
    **dict.fromkeys(("ply", "motion", "splat-ply", "png"), MAX_TURBULENT_FRAMES),
    **dict.fromkeys(("webp", "usd", "usd-splat", "alembic", "vat"), MAX_FRAMES),
    "mp4": MAX_TURBULENT_FILM_FRAMES,
}
"""Most frames of a turbulent motion by format; formats that are not listed store only one period."""
Resolution = Literal[32, 64, 128, 256, 512]
UpAxis = Annotated[
    str,
    Field(max_length=80),
    Pattern(f"^([+-]?[XYZxyz]|{DIRECTION_PATTERN})$", "X, Y or Z with a sign, or a direction such as 0.17,-0.97,0.17"),
    AfterValidator(lambda axis: f"+{axis.upper()}" if len(axis) == 1 else axis.upper()),
]
"""One of +X, -X, +Y, -Y, +Z and -Z, with an optional +, or a direction."""


class Reading(Request):
    """How to read a file whose format does not say its axes or unit."""

    up_axis: UpAxis | None = Field(
        default=None,
        description="Up axis of the file: X, Y or Z with a sign, or a direction in its axes such as "
        "0.17,-0.97,0.17; by default detected",
    )
    unit_m: Finite | None = Field(
        default=None,
        ge=1e-6,
        le=1e6,
        description="Metres per unit of the file (0.01 for centimetres); by default detected",
    )
    height_m: Finite | None = Field(
        default=None,
        gt=0,
        lt=1000,
        description="Height of the tree [m], which sets the scale instead of unit_m; by default the file's",
    )


class CloudParams(Request):
    """Which parts move: by default the plant as it is detected; `moving`, then `still`, then `box_m` change that."""

    box_m: Box | None = Field(
        default=None,
        description="Box outside which nothing moves: low and high corner [m], +Z up; by default none. For photos: "
        "box around the plant, in the frame of a job with the same height_m and no box",
    )
    still: PartNames | None = Field(
        default=None,
        description="Parts that stand still: nodes and materials of a mesh, still_parts of a splat or scan; "
        "* matches any characters, ? one",
    )
    moving: PartNames | None = Field(
        default=None, description="Parts that move although they were detected as no plant; names as in still"
    )
    still_box_m: Box | None = Field(default=None, description="Box in which all stands still: low and high corner [m]")
    moving_box_m: Box | None = Field(
        default=None, description="Box in which all moves, also what is detected as no plant: low and high corner [m]"
    )
    tree: int | None = Field(
        default=None,
        ge=1,
        le=10_000,
        description="Number of the only tree to use, as in `trees`; by default all trees of a file, each by itself",
    )


class GridParams(Request):
    """How fine the voxel grid is. Paper section 3.3."""

    resolution: Resolution = Field(default=128, description="Number of voxels per side of the cube")


class GeneratorGridParams(Request):
    """The voxel grids that a model can move."""

    resolution: Literal[128, 256, 512] = Field(default=128, description="Number of voxels per side of the cube")


class ModelParams(Request):
    """Which model generates the motion, and which of its motions."""

    preset: str = Field(default="small", max_length=1024, description="Model that generates the motion")
    seed: int = Field(default=0, ge=0, le=MAX_SEED, description="Random seed; the same seed gives the same motion")


@dataclass(frozen=True, kw_only=True)
class Wind:
    """Wind for which a motion is generated. Python does not check the ranges: a file may record any wind."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    speed_m_s: Annotated[Finite, Field(ge=0, le=30, description="Mean speed of the wind [m/s]")] = 5.0
    direction_deg: Annotated[
        Finite, Field(ge=-360, le=360, description="Direction to which the wind blows [°], from +X towards +Y")
    ] = 0.0
    gust: Annotated[Finite, Field(ge=0, le=2, description="Standard deviation of speed / mean speed")] = 0.3


class SpectrumParams(Request):
    """How the spectrum is generated. Paper section 3.4."""

    wind: Wind = Field(default_factory=Wind)
    num_steps: int | None = Field(
        default=None, ge=1, le=1000, description="Number of sampler steps; by default the preset's"
    )
    period_s: Finite | None = Field(
        default=None,
        ge=2,
        le=30,
        description="Length of the loop [s]; by default from the height: 4.17 s up to 7 m, 16.7 s from 22 m; 4.17 s "
        "if num_frames is set or the preset is the paper's",
    )
    foliage: Share | None = Field(
        default=None,
        description="Foliage, which damps the motion: 0 (bare) to 1 (in leaf); by default as a mesh's shape shows, in "
        "between for a splat, scan or photos",
    )
    wind_bands: bool = Field(
        default=False,
        description="Also generate winds of 1, 4, 8, 14 and 20 m/s, for the strength of each mode in any wind",
    )


class SwingParams(Request):
    """How a tree answers forces, see docs/interaction.md."""

    damping_ratio: Finite | None = Field(
        default=None, ge=0, le=2, description="Damping ratio of all modes; by default 0.04 (bare) to 0.13 (in leaf)"
    )
    foliage: Share | None = Field(
        default=None, description="Foliage for damping and frequency: 0 bare, 1 in leaf; by default the spectrum's"
    )
    frequency_hz: Finite | None = Field(
        default=None,
        ge=1e-3,
        le=100,
        description="Lowest natural frequency [Hz]; by default that of real trees of this height",
    )
    mass_kg: Finite | None = Field(
        default=None, ge=1e-3, le=LARGEST, description="Moving mass [kg]; by default from the tree's height"
    )
    locality: Literal["none", "geodesic"] = Field(
        default="geodesic", description="Reach of a push: the whole tree, or its branch and, less, what carries it"
    )
    falloff_m: Finite | None = Field(
        default=None,
        ge=1e-3,
        le=LARGEST,
        description="Distance over which a push fades [m]; default: 15 % of the height",
    )


class InteractParams(SwingParams):
    """How the answer of a tree to forces is computed."""

    integrator: Integrator = Field(default="exact", description="Method of time integration")


class Shot(Request):
    """Camera of pictures and videos."""

    side_px: int = Field(default=512, ge=64, le=1080, description="Side length of pictures [px]")
    azimuth_deg: Finite = Field(
        default=25.0, ge=-360, le=360, description="Direction from the tree to the camera [°]: 0 at -Y, 90 at +X"
    )
    elevation_deg: Finite = Field(
        default=8.0, ge=-30, le=80, description="Elevation of the camera above the horizon [°]"
    )
    orbit: bool = Field(default=False, description="Move the camera around the tree once")
    ground: bool = Field(default=True, description="Draw a floor with a shadow")
    grey_still: bool = Field(
        default=True, description="In films, draw still parts that are no plant (a pot, a table, the ground) in grey"
    )


class ExportParams(Request):
    """Which frames of a motion are written, and as what. Frame n shows the motion at time n · speed / fps."""

    wind_mode: WindMode = Field(
        default="loop", description="Motion that repeats after one period (loop), or turbulent wind that never repeats"
    )
    first_frame: int = Field(default=0, ge=0, le=MAX_FIRST_FRAME, description="Number of the first frame to write")
    num_frames: int | None = Field(
        default=None,
        ge=1,
        le=MAX_TURBULENT_FRAMES,
        description=f"Number of frames to write, at most {MAX_FRAMES} of a loop; by default one period, or "
        f"{TURBULENT_S:g} s of turbulent wind",
    )
    fps: Finite = Field(
        default=24.0, ge=1, le=240, description="Frames per second, which do not change the speed of the motion"
    )
    speed: Finite = Field(default=1.0, ge=0.01, le=100, description="Speed of the motion / natural speed")
    loop: bool = Field(
        default=True, description="Refuse frames that are not a whole number of periods, except in turbulent wind"
    )
    flutter: Finite = Field(
        default=1.0,
        ge=0,
        le=2,
        description="Flutter of leaves at frequencies above the spectrum's, up to 8 Hz: 0 is none, 1 as in nature at "
        "this wind speed. Morph targets and `rig` have none",
    )
    formats: (
        tuple[Annotated[Format, BeforeValidator(lambda name: "glb" if name == "glb-skinned" else name)], ...] | None
    ) = Field(
        default=None,
        min_length=1,
        max_length=16,
        description=f"Files to write; by default {', '.join(MESH_FORMATS)} of a mesh or photos, "
        f"{', '.join(CLOUD_FORMATS)} of a splat or scan",
    )
    share: Finite = Field(default=1.0, gt=0, le=1, description="Share of a splat's Gaussians to write")
    sh_degree: int = Field(
        default=3, ge=0, le=3, description="Highest degree of a splat's spherical harmonics to write"
    )
    normals: bool = Field(default=False, description="Write moving normals as a texture of vat")
    glb_compression: Literal["none", "meshopt"] = Field(
        default="none", description="Compression of glb; meshopt needs a reader of EXT_meshopt_compression"
    )
    glb_textures: Literal["source", "webp"] = Field(
        default="source",
        description="Textures of glb: those of the source, or WebP where that is smaller, which needs a "
        "reader of EXT_texture_webp",
    )
    joints: Literal[32, 64, 256] | None = Field(
        default=None, description="Largest number of joints of glb and usd-skinned; by default all bones of the tree"
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
            if name not in TURBULENT_FRAMES:
                raise InputError(
                    f"a file of format {name} holds one period and no turbulent motion: take "
                    f"{', '.join(TURBULENT_FRAMES)}, or {name} with wind_mode loop"
                )
            if (count := self.count_frames(1.0)) > (most := TURBULENT_FRAMES[name]):
                raise InputError(f"num_frames is {count}; at most {most} are allowed of a turbulent motion as {name}")
        return formats


class ReconstructParams(PhotoParams, CloudParams):
    """Parameters of a job that makes a mesh from photos or a cloud."""


class VoxelizeParams(GridParams, ReconstructParams):
    """Parameters of a job that voxelizes a surface."""


class DiffuseParams(SpectrumParams, ReconstructParams):
    """Parameters of a job that generates a spectrum."""


class AnimateParams(ExportParams, DiffuseParams):
    """Parameters of a job that writes a motion. The service always writes png too."""


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
