"""What a motion is written as: which frames, of what, and one writer a product of a mesh."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import BinaryIO

import numpy as np
from jaxtyping import Complex64, Float32, Float64, UInt8

from dynamictree.errors import InputError
from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.motion.ply_sequence import iter_ply_sequence_zip
from dynamictree.formats.tensors.motion import write_motion
from dynamictree.mesh import TriangleMesh
from dynamictree.render.shot import Shot
from dynamictree.spectrum import SparseVoxelSpectrum, iter_motion

MESH_FILE_NAMES = {
    "ply": "motion.ply.zip",
    "glb": "tree.glb",
    "glb-reduced": "tree-8-targets.glb",
    "glb-skinned": "tree-skinned.glb",
    "usd": "tree.usdz",
    "vat": "tree.vat.zip",
    "motion": "motion.safetensors",
}
SPLAT_FILE_NAMES = {
    "splat-ply": "splat.ply.zip",
    "splat": "tree.animated-splat.safetensors",
}
PICTURE_FILE_NAMES = {
    "png": "preview.png",
    "webp": "preview.webp",
    "mp4": "preview.mp4",
}
FILE_NAMES = MESH_FILE_NAMES | SPLAT_FILE_NAMES | PICTURE_FILE_NAMES
"""Of each format."""
DEFAULT_FORMATS = ("ply", "glb", "png")
DEFAULT_CLOUD_FORMATS = ("splat", "png")
REDUCED_TARGETS = 8  # morph targets that glTF asks every engine to support
MAX_FRAMES = 600

Report = Callable[[float], None]
"""Gets the share done in [0, 1]; what it raises passes through."""
Facts = dict[str, int | float]
"""What a product has to tell of itself: how far it is from the motion. Empty where it is exact."""


@dataclass(frozen=True, kw_only=True)
class AnimateOptions:
    """Which frames of the motion are written, and as what. Frame n shows the spectrum at time n · speed / fps.

    `num_frames=None` is one period. fps never changes the speed of the motion. `share` and `sh_degree` make splats
    lighter: the share of the Gaussians that is kept, and the highest degree of their harmonics.
    """

    first_frame: int = 0
    num_frames: int | None = None
    fps: float = 24.0  # [1/s]
    speed: float = 1.0
    loop: bool = True
    formats: tuple[str, ...] = DEFAULT_FORMATS
    share: float = 1.0
    sh_degree: int = 3
    shot: Shot = field(default_factory=Shot)

    def __post_init__(self) -> None:
        unknown = [name for name in self.formats if name not in FILE_NAMES]
        if unknown or not self.formats:
            raise InputError(f"formats are {list(self.formats)}; choose from {', '.join(FILE_NAMES)}")
        if not 1 <= self.fps <= 240:
            raise InputError(f"fps is {self.fps:g}; 1 to 240 frames a second are allowed")
        if not 0.01 <= self.speed <= 100:
            raise InputError(f"speed is {self.speed:g}; 0.01 to 100 times the natural speed are allowed")
        if self.num_frames is not None and not 1 <= self.num_frames <= MAX_FRAMES:
            raise InputError(f"num_frames is {self.num_frames}; 1 to {MAX_FRAMES} are allowed")
        if not 0 <= self.first_frame < MAX_FRAMES:
            raise InputError(f"first_frame is {self.first_frame}; 0 to {MAX_FRAMES - 1} are allowed")
        if not 0 < self.share <= 1:
            raise InputError(f"share is {self.share:g}; above 0 and at most 1 of the Gaussians is allowed")
        if not 0 <= self.sh_degree <= 3:
            raise InputError(f"sh_degree is {self.sh_degree}; 0 to 3 are allowed")

    def phases(self, period_s: float) -> Float64[np.ndarray, " M"]:
        """Place in the loop of every frame, in periods.

        Raises:
            InputError: `loop` is set and the frames are not a whole number of periods, or there are too many.
        """
        period_frames = self.fps * period_s / self.speed
        num_frames = max(round(period_frames), 1) if self.num_frames is None else self.num_frames
        if self.loop and not _is_whole(num_frames / period_frames):
            raise InputError(
                f"{num_frames} frames at {self.fps:g} fps and speed {self.speed:g} are {num_frames / period_frames:.4g}"
                f" periods of {period_s:.4g} s, so the loop would jump; {_nearest_loops(num_frames, period_frames)}"
            )
        if num_frames > MAX_FRAMES:
            raise InputError(f"one period is {num_frames} frames; at most {MAX_FRAMES} are allowed: lower fps")
        return (self.first_frame + np.arange(num_frames)) / period_frames


FRAME_OPTIONS = frozenset(option.name for option in fields(AnimateOptions)) - {"formats", "shot"}
"""The options that say which frames are written, and how heavy."""


def _is_whole(periods: float) -> bool:
    return round(periods) >= 1 and abs(periods - round(periods)) < 1e-6


def _nearest_loops(num_frames: int, period_frames: float) -> str:
    loops = [count for count in range(1, MAX_FRAMES + 1) if _is_whole(count / period_frames)]
    if not loops:
        return f"no number of frames up to {MAX_FRAMES} makes a loop at this fps and speed: take fps 24 or loop=false"
    below = [count for count in loops if count < num_frames][-1:]
    above = [count for count in loops if count > num_frames][:1]
    return f"{' or '.join(map(str, below + above))} frames make a loop; or take loop=false"


@dataclass(frozen=True, kw_only=True)
class SwayingMesh:
    """A mesh, its vertices' spectrum, and the frames of it that are asked for."""

    mesh: TriangleMesh
    coefficients: Complex64[np.ndarray, "N K 3"]  # [m]
    num_frames: int  # T of the spectrum
    loop_fps: float  # frames of the spectrum that go by in a second of the file's time
    phases: Float64[np.ndarray, " M"]  # of the frames to write, in periods
    fps: float  # of the frames to write
    first_frame: int = 0  # number of the first in the names of the files
    loop: bool = True  # whether the frames are whole periods
    spectrum: SparseVoxelSpectrum | None = None  # of the voxels; what a skeleton is found in

    def frames(self, report: Report) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """One frame of displacement after another [m]."""
        for done, frame in enumerate(iter_motion(self.coefficients, self.phases, self.num_frames)):
            report(done / len(self.phases))
            yield frame


def write_mesh_product(name: str, sway: SwayingMesh, stream: BinaryIO, report: Report) -> Facts:
    """Write one of `MESH_FILE_NAMES` to an open file.

    Raises:
        InputError: there is no skeleton in the spectrum, or no texture that holds the motion.
    """
    return _WRITERS[name](sway, stream, report) or {}


def iter_mesh_pictures(sway: SwayingMesh, shot: Shot, report: Report) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """The mesh, frame by frame."""
    from dynamictree.render import Look, Renderer

    renderer = Renderer(sway.mesh, Look(width=shot.side_px, height=shot.side_px, ground=shot.ground))
    cameras = shot.cameras(sway.mesh.vertices, len(sway.phases))
    for frame, camera in zip(sway.frames(report), cameras, strict=True):
        yield renderer.picture(frame, camera=camera)


def _write_ply(sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    stream.writelines(iter_ply_sequence_zip(sway.mesh, sway.frames(report), first_number=sway.first_frame))


def _write_motion(sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    write_motion(sway.mesh, sway.frames(report), stream, num_frames=len(sway.phases), fps=sway.fps)


def _write_glb(sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    write_motion_glb(sway.mesh, sway.coefficients, stream, num_frames=sway.num_frames, fps=sway.loop_fps)


def _write_reduced_glb(sway: SwayingMesh, stream: BinaryIO, report: Report) -> Facts:
    num_targets = min(REDUCED_TARGETS, 2 * sway.coefficients.shape[1] - 1)
    summary = write_motion_glb(
        sway.mesh,
        sway.coefficients,
        stream,
        num_frames=sway.num_frames,
        fps=sway.loop_fps,
        num_targets=num_targets,
    )
    return asdict(summary)


def _write_skinned_glb(sway: SwayingMesh, stream: BinaryIO, report: Report) -> Facts:
    from dynamictree.formats.gltf.skin import write_skinned_glb
    from dynamictree.modal.skinning import skin_of

    assert sway.spectrum is not None
    skin, summary = skin_of(sway.spectrum, sway.mesh, sway.coefficients)
    write_skinned_glb(sway.mesh, skin, summary, stream, fps=sway.loop_fps)
    return asdict(summary)


def _write_usdz(sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    from dynamictree.formats.motion.usd import write_motion_usdz

    write_motion_usdz(sway.mesh, sway.frames(report), stream, fps=sway.fps)


def _write_vertex_texture(sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    from dynamictree.formats.motion.vertex_texture import iter_vertex_texture_zip

    num_frames = len(sway.phases)
    chunks = iter_vertex_texture_zip(
        sway.mesh, sway.frames(report), num_frames=num_frames, fps=sway.fps, loop=sway.loop
    )
    stream.writelines(chunks)


_WRITERS: dict[str, Callable[[SwayingMesh, BinaryIO, Report], Facts | None]] = {
    "ply": _write_ply,
    "glb": _write_glb,
    "glb-reduced": _write_reduced_glb,
    "glb-skinned": _write_skinned_glb,
    "usd": _write_usdz,
    "vat": _write_vertex_texture,
    "motion": _write_motion,
}
