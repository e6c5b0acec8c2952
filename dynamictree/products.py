"""What a motion is written as: which frames, of what, and one writer a product of a mesh."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import BinaryIO

import numpy as np
from jaxtyping import Complex64, Float32, Float64, UInt8

from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.motion.ply_sequence import iter_ply_sequence_zip
from dynamictree.formats.tensors.motion import write_motion
from dynamictree.mesh import TriangleMesh
from dynamictree.render.shot import cameras_of
from dynamictree.requests import ExportParams, Format, Shot
from dynamictree.spectrum import SparseVoxelSpectrum, iter_motion

MESH_FILE_NAMES: dict[Format, str] = {
    "ply": "motion.ply.zip",
    "glb": "tree.glb",
    "glb-reduced": "tree-8-targets.glb",
    "glb-skinned": "tree-skinned.glb",
    "usd": "tree.usdz",
    "vat": "tree.vat.zip",
    "motion": "motion.safetensors",
}
SPLAT_FILE_NAMES: dict[Format, str] = {
    "splat-ply": "splat.ply.zip",
    "splat": "tree.animated-splat.safetensors",
}
PICTURE_FILE_NAMES: dict[Format, str] = {
    "png": "preview.png",
    "webp": "preview.webp",
    "mp4": "preview.mp4",
}
FILE_NAMES = MESH_FILE_NAMES | SPLAT_FILE_NAMES | PICTURE_FILE_NAMES
"""Of each format."""
REDUCED_TARGETS = 8  # morph targets that glTF asks every engine to support

Report = Callable[[float], None]
"""Gets the share done in [0, 1]; what it raises passes through."""
Facts = dict[str, int | float]
"""What a product has to tell of itself: how far it is from the motion. Empty where it is exact."""


def phases(params: ExportParams, period_s: float) -> Float64[np.ndarray, " M"]:
    """Place in the loop of every frame to write, in periods.

    Raises:
        InputError: `loop` is set and the frames are not a whole number of periods, or there are too many.
    """
    return (params.first_frame + np.arange(params.count_frames(period_s))) / params.period_frames(period_s)


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


def write_mesh_product(name: Format, sway: SwayingMesh, stream: BinaryIO, report: Report) -> Facts:
    """Write one of `MESH_FILE_NAMES` to an open file.

    Raises:
        InputError: there is no skeleton in the spectrum, or no texture that holds the motion.
    """
    return _WRITERS[name](sway, stream, report) or {}


def iter_mesh_pictures(sway: SwayingMesh, shot: Shot, report: Report) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """The mesh, frame by frame."""
    from dynamictree.render import Look, Renderer

    renderer = Renderer(sway.mesh, Look(width=shot.side_px, height=shot.side_px, ground=shot.ground))
    cameras = cameras_of(shot, sway.mesh.vertices, len(sway.phases))
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


_WRITERS: dict[Format, Callable[[SwayingMesh, BinaryIO, Report], Facts | None]] = {
    "ply": _write_ply,
    "glb": _write_glb,
    "glb-reduced": _write_reduced_glb,
    "glb-skinned": _write_skinned_glb,
    "usd": _write_usdz,
    "vat": _write_vertex_texture,
    "motion": _write_motion,
}
