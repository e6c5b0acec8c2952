"""What a splat's motion is written as: the same frames as its mesh's, one writer a product."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from dynamictree.errors import InputError
from dynamictree.formats.animated_splat import write_animated_splat
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.splat_sequence import iter_splat_sequence_zip, splat_sequence_bytes
from dynamictree.gaussian.animate import AnimatedSplat, iter_poses, lighter
from dynamictree.gaussian.binding import Binding, bind, in_box
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from dynamictree.products import Report, SwayingMesh

SPLAT_FILE_NAMES = {
    "ply": "motion.ply.zip",
    "splat": "tree.animated-splat.safetensors",
    "png": "preview.png",
    "webp": "preview.webp",
    "mp4": "preview.mp4",
}
"""Of each format."""
DEFAULT_SPLAT_FORMATS = ("ply", "splat", "png")
MAX_SEQUENCE_BYTES = 64 * 1024**3  # of an archive; a lower degree, fewer Gaussians or frames make it smaller
_PREVIEW_PX = 512
_SKY, _HAZE = (0.72, 0.82, 0.93), (0.95, 0.94, 0.91)  # behind previews, from above to below
_SLICE_HEIGHT = 0.35  # of the picture, from above: where a crown is


@dataclass(frozen=True, kw_only=True)
class SplatOptions:
    """What of a splat is written, and what of it moves."""

    formats: tuple[str, ...] = DEFAULT_SPLAT_FORMATS
    share: float = 1.0  # of the Gaussians: level of detail
    sh_degree: int = 3  # at most
    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None  # only what is inside moves

    def __post_init__(self) -> None:
        unknown = [name for name in self.formats if name not in SPLAT_FILE_NAMES]
        if unknown or not self.formats:
            raise InputError(f"formats are {list(self.formats)}; choose from {', '.join(SPLAT_FILE_NAMES)}")


def load_cloud(path: Path, *, up_axis: str | None = None, unit_m: float | None = None) -> GaussianCloud:
    """Read a splat or scan by its file's ending, in metres and +Z up.

    Raises:
        InputError: it cannot be read, or is no cloud that the method can work on.
    """
    with path.open("rb") as stream:
        return read_cloud(stream, file_type=path.suffix.lower().removeprefix("."), up_axis=up_axis, unit_m=unit_m)


def moving_part(cloud: GaussianCloud, options: SplatOptions) -> Bool[np.ndarray, " G"]:
    """Which Gaussians may move.

    Raises:
        InputError: there are none in the box.
    """
    return np.ones(cloud.num_gaussians, np.bool_) if options.box_m is None else in_box(cloud, *options.box_m)


def mesh_of_moving_part(cloud: GaussianCloud, options: SplatOptions) -> TriangleMesh:
    """A mesh for a capture that comes without: what is voxelised, and what the Gaussians hang on.

    Raises:
        InputError: nothing in the box, or nothing opaque enough to have a surface.
    """
    from dynamictree.gaussian.surface import mesh_of_cloud

    return mesh_of_cloud(cloud.subset(moving_part(cloud, options)))


def animate_splat(
    cloud: GaussianCloud, sway: SwayingMesh, options: SplatOptions, folder: Path, on_progress: Report | None = None
) -> dict[str, Path]:
    """Write the asked products of a cloud that moves as a mesh does into a folder; give their paths by format.

    `on_progress` gets the share done in [0, 1]; what it raises passes through.

    Raises:
        InputError: the cloud is not where the mesh is, or the archive would be too large.
    """
    binding = lighter(
        bind(cloud, sway.mesh, mask=moving_part(cloud, options)), share=options.share, sh_degree=options.sh_degree
    )
    size = splat_sequence_bytes(binding, len(sway.phases))
    if "ply" in options.formats and size > MAX_SEQUENCE_BYTES:
        raise InputError(
            f"{len(sway.phases)} frames of {binding.cloud.num_gaussians:,} Gaussians of SH degree "
            f"{binding.cloud.sh_degree} are {size / 1e9:.1f} GB, above {MAX_SEQUENCE_BYTES / 1e9:.1f} GB: "
            "ask for fewer frames, a lower sh_degree or share, or for the format splat"
        )
    paths = {name: folder / SPLAT_FILE_NAMES[name] for name in options.formats}
    for place, (name, path) in enumerate(paths.items()):

        def report(done: float, place: int = place) -> None:
            if on_progress is not None:
                on_progress((place + done) / len(paths))

        with path.open("wb") as stream:
            _WRITERS[name](binding, sway, stream, report)
        report(1.0)
    return paths


def _write_ply(binding: Binding, sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    stream.writelines(iter_splat_sequence_zip(binding, sway.frames(report)))


def _write_compact(binding: Binding, sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    splat = AnimatedSplat(
        binding=binding, coefficients=sway.coefficients, num_frames=sway.num_frames, fps=sway.loop_fps
    )
    write_animated_splat(splat, stream)


def _write_webp(binding: Binding, sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    from dynamictree.render import write_animation

    write_animation(_pictures(binding, sway, report), stream, fps=sway.fps, format="webp")


def _write_mp4(binding: Binding, sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    from dynamictree.render import write_animation

    write_animation(_pictures(binding, sway, report), stream, fps=sway.fps, format="mp4")


def _write_png(binding: Binding, sway: SwayingMesh, stream: BinaryIO, report: Report) -> None:
    """The first frame, and beside it one of its rows through the whole motion: the space-time slice of the paper."""
    from dynamictree.render import write_png

    row = int(_PREVIEW_PX * _SLICE_HEIGHT)
    first, slices = None, list[UInt8[np.ndarray, "W 3"]]()
    for picture in _pictures(binding, sway, report):
        first = picture if first is None else first
        slices.append(picture[row])
    assert first is not None
    marked = first.copy()
    marked[row, ::8] = (200, 40, 40)
    times = np.linspace(0, len(slices) - 1, _PREVIEW_PX).round().astype(int)
    write_png(np.concatenate([marked, np.stack(slices)[times]], axis=1), stream)


def _pictures(binding: Binding, sway: SwayingMesh, report: Report) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """Frames from the front, a little from above, before a hazy sky."""
    from dynamictree.gaussian.rasterize import render_cloud
    from dynamictree.render import Camera

    camera = Camera.orbit(binding.cloud.means[binding.moving])
    sky = _sky(_PREVIEW_PX)
    for pose in iter_poses(binding, sway.frames(report)):
        picture = render_cloud(binding.cloud, camera, width=_PREVIEW_PX, height=_PREVIEW_PX, pose=pose)
        yield picture.over(sky)


def _sky(side: int) -> Float32[np.ndarray, "H W 3"]:
    share = np.linspace(0, 1, side, dtype=np.float32)[:, None, None]
    return np.broadcast_to(
        (1 - share) * np.array(_SKY, np.float32) + share * np.array(_HAZE, np.float32), (side, side, 3)
    ).copy()


_WRITERS: dict[str, Callable[[Binding, SwayingMesh, BinaryIO, Report], None]] = {
    "ply": _write_ply,
    "splat": _write_compact,
    "png": _write_png,
    "webp": _write_webp,
    "mp4": _write_mp4,
}
