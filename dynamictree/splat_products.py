"""What a splat's motion is written as: the same frames as its mesh's, one writer a product."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from dynamictree.errors import InputError
from dynamictree.formats.motion.splat_sequence import iter_splat_sequence_zip, splat_sequence_bytes
from dynamictree.formats.tensors.animated_splat import write_animated_splat
from dynamictree.gaussian.animate import AnimatedSplat, iter_poses, lighter
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.cloud import MAX_SEQUENCE_BYTES, GaussianCloud, area_m2, level_count
from dynamictree.products import Report, SwayingMesh
from dynamictree.render.camera import Camera
from dynamictree.render.shot import cameras_of
from dynamictree.requests import ExportParams, Format, Shot

PREVIEW_GAUSSIANS = 200_000
"""Of a larger cloud its level of detail is drawn: 0.2 s a picture on two cores."""
_STRIP = 8  # pictures in the row below
_MOST = 0.95  # of the Gaussians; a few may be as large as the scene
_STRAYS = 0.001  # of the cloud at its lower end lies below the floor


@dataclass(frozen=True, kw_only=True)
class SwayingSplat:
    """A cloud, what it hangs on, and the frames that are asked for."""

    binding: Binding
    sway: SwayingMesh


def sequence_bytes(num_gaussians: int, sh_degree: int, num_frames: int, params: ExportParams) -> int:
    """Size of the archive `splat-ply` before anything is made.

    Raises:
        InputError: it would be too large.
    """
    kept, degree = level_count(num_gaussians, params.share), min(sh_degree, params.sh_degree)
    size = splat_sequence_bytes(kept, degree, num_frames, first_number=params.first_frame)
    if size > MAX_SEQUENCE_BYTES:
        raise InputError(
            f"{num_frames} frames of {kept:,} Gaussians of SH degree {degree} are {size / 1e9:.1f} GB, above "
            f"{MAX_SEQUENCE_BYTES / 1e9:.1f} GB: ask for fewer frames, a lower sh_degree or share, or for the format "
            "splat"
        )
    return size


def lighter_splat(splat: SwayingSplat, params: ExportParams) -> SwayingSplat:
    """The splat with the share and degree that are asked for."""
    binding = lighter(splat.binding, share=params.share, sh_degree=params.sh_degree)
    return SwayingSplat(binding=binding, sway=splat.sway)


def write_splat_product(name: Format, splat: SwayingSplat, stream: BinaryIO, report: Report) -> None:
    """Write one of `SPLAT_FILE_NAMES` to an open file."""
    _WRITERS[name](splat, stream, report)


def iter_splat_pictures(splat: SwayingSplat, shot: Shot, report: Report) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """The cloud, frame by frame, on a floor with its shadow, before the sky."""
    from dynamictree.gaussian.rasterize import render_cloud
    from dynamictree.render import Backdrop

    count = splat.binding.cloud.num_gaussians
    binding = lighter(splat.binding, share=min(1.0, PREVIEW_GAUSSIANS / count))
    cloud, side = binding.cloud, shot.side_px
    shown = _framed(cloud.subset(binding.moving))
    floor = float(np.quantile(shown[:, 2], _STRAYS))
    centre, radius = _footprint(shown)
    covered = (np.pi * area_m2(cloud) * cloud.opacity)[binding.moving]
    behind: tuple[Camera, Backdrop] | None = None
    for pose, camera in zip(
        iter_poses(binding, splat.sway.frames(report)), cameras_of(shot, shown, len(splat.sway.phases)), strict=True
    ):
        if behind is None or behind[0] is not camera:
            ground = floor if shot.ground else -np.inf
            behind = (camera, Backdrop(camera, side_px=side, ground_m=ground, centre_m=centre, radius_m=radius))
        backdrop = behind[1].picture(pose.means[binding.moving], covered) if shot.ground else behind[1].picture()
        yield render_cloud(cloud, camera, width=side, height=side, pose=pose).over(backdrop)


def splat_sheet(film: UInt8[np.ndarray, "T H W 3"]) -> UInt8[np.ndarray, "A B 3"]:
    """The first frame; beside it one of its rows through the motion, the paper's space-time slice; below, frames."""
    side = film.shape[1]
    chosen = np.linspace(0, len(film), _STRIP, endpoint=False).astype(int)
    row = int(film[chosen].std(axis=0).mean(axis=(1, 2)).argmax())  # where most moves
    marked = film[0].copy()
    marked[row, ::8] = (200, 40, 40)
    times = np.linspace(0, len(film) - 1, side).round().astype(int)
    above = np.concatenate([marked, film[times, row]], axis=1)  # [side, 2 side, 3]
    small = 2 * side // _STRIP
    below = [np.asarray(Image.fromarray(film[n]).resize((small, small), Image.Resampling.LANCZOS)) for n in chosen]
    return np.concatenate([above, np.concatenate(below, axis=1)])


def _framed(cloud: GaussianCloud) -> Float32[np.ndarray, "M 3"]:
    """What a picture must hold: the Gaussians' middles, and as far around them as most of them reach [m]."""
    sigma = cloud.scales.max(axis=1, keepdims=True)
    reach = np.minimum(sigma, np.quantile(sigma, _MOST).astype(np.float32))
    return np.concatenate([cloud.means - reach, cloud.means + reach])


def _footprint(points: Float32[np.ndarray, "G 3"]) -> tuple[Float32[np.ndarray, "2"], float]:
    """Middle of the points seen from above, and the radius of a ball around them [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (low[:2] + high[:2]) / np.float32(2), max(float(np.linalg.norm(high - low)) / 2, 1e-6)


def _write_sequence(splat: SwayingSplat, stream: BinaryIO, report: Report) -> None:
    frames = splat.sway.frames(report)
    stream.writelines(iter_splat_sequence_zip(splat.binding, frames, first_number=splat.sway.first_frame))


def _write_compact(splat: SwayingSplat, stream: BinaryIO, report: Report) -> None:
    sway = splat.sway
    compact = AnimatedSplat(
        binding=splat.binding, coefficients=sway.coefficients, num_frames=sway.num_frames, fps=sway.loop_fps
    )
    write_animated_splat(compact, stream)


_WRITERS: dict[Format, Callable[[SwayingSplat, BinaryIO, Report], None]] = {
    "splat-ply": _write_sequence,
    "splat": _write_compact,
}


def describe_sequence(cloud: GaussianCloud, num_frames: int, params: ExportParams) -> str:
    """How large the PLY sequence will be, in words.

    Raises:
        InputError: it would be too large.
    """
    size = sequence_bytes(cloud.num_gaussians, cloud.sh_degree, num_frames, params)
    kept, degree = level_count(cloud.num_gaussians, params.share), min(cloud.sh_degree, params.sh_degree)
    return f"{num_frames} frames of {kept:,} Gaussians of SH degree {degree}: {size / 1e6:,.1f} MB"
