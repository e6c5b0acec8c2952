"""Pictures and films of a moving mesh or splat."""

from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from dynamictree.export.moving_tree import MovingTree, Report
from dynamictree.gaussian.animate import iter_poses, lighter
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.cloud import GaussianCloud, area_m2
from dynamictree.render.camera import Camera
from dynamictree.render.shot import cameras_of

Picture = UInt8[np.ndarray, "H W 3"]
Film = UInt8[np.ndarray, "M H W 3"]

PREVIEW_GAUSSIANS = 200_000
"""A larger cloud is drawn at a lower level of detail: 0.2 s per picture on two cores."""
_STRIP = 8  # pictures in the row at the bottom of a sheet
_MOST = 0.95  # of the Gaussians; a few may be as large as the scene
_STRAYS = 0.001  # share of the Gaussians, the lowest, that may lie below the floor


def write_mesh_sheet(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """PNG of the mesh: one picture, the amplitude of the sway in colours, a space-time slice and a row of frames."""
    from dynamictree.render import preview_sheet, write_png

    write_png(preview_sheet(tree.mesh, tree.coefficients, num_frames=tree.spectrum.num_frames), stream)


def write_film_sheet(film: Film, stream: BinaryIO, fps: float) -> None:
    """PNG of a film: its first frame, a space-time slice and a row of frames."""
    from dynamictree.render import write_png

    write_png(_sheet(film), stream)


def write_webp(film: Film, stream: BinaryIO, fps: float) -> None:
    """Animated WebP that loops."""
    from dynamictree.render import write_animation

    write_animation(iter(film), stream, fps=fps, format="webp")


def write_mp4(film: Iterable[Picture], stream: BinaryIO, fps: float) -> None:
    """MP4 video, written as its pictures come."""
    from dynamictree.render import write_animation

    write_animation(iter(film), stream, fps=fps, format="mp4")


def draw(tree: MovingTree, report: Report) -> Iterator[Picture]:
    """Draw the frames of a film: of the splat where one was captured, else of the mesh."""
    if tree.captured and tree.binding is not None:
        return _draw_splat(tree, tree.binding, report)
    return _draw_mesh(tree, report)


def _draw_mesh(tree: MovingTree, report: Report) -> Iterator[Picture]:
    from dynamictree.render import Look, Renderer

    shot = tree.params.shot
    renderer = Renderer(tree.mesh, Look(width=shot.side_px, height=shot.side_px, ground=shot.ground))
    cameras = cameras_of(shot, tree.mesh.vertices[~tree.mesh.still_vertices], len(tree.phases))
    for frame, camera in zip(tree.frames(report), cameras, strict=True):
        yield renderer.picture(frame, camera=camera)


def _draw_splat(tree: MovingTree, binding: Binding, report: Report) -> Iterator[Picture]:
    """Draw the Gaussians over a floor with their shadow and a sky."""
    from dynamictree.gaussian.rasterize import render_cloud
    from dynamictree.render import Backdrop

    shot, side = tree.params.shot, tree.params.shot.side_px
    binding = lighter(binding, share=min(1.0, PREVIEW_GAUSSIANS / binding.cloud.num_gaussians))
    cloud = binding.cloud
    bounds = _bounding_points(cloud.subset(binding.moving))
    floor = float(np.quantile(bounds[:, 2], _STRAYS))
    centre, radius = _footprint(bounds)
    covered = (np.pi * area_m2(cloud) * cloud.opacity)[binding.moving]
    behind: tuple[Camera, Backdrop] | None = None
    poses = iter_poses(binding, tree.frames(report))
    for pose, camera in zip(poses, cameras_of(shot, bounds, len(tree.phases)), strict=True):
        if behind is None or behind[0] is not camera:
            ground = floor if shot.ground else -np.inf
            behind = (camera, Backdrop(camera, side_px=side, ground_m=ground, centre_m=centre, radius_m=radius))
        backdrop = behind[1].picture(pose.means[binding.moving], covered) if shot.ground else behind[1].picture()
        yield render_cloud(cloud, camera, width=side, height=side, pose=pose).over(backdrop)


def _sheet(film: Film) -> UInt8[np.ndarray, "A B 3"]:
    """The first frame; beside it one of its rows over time, the paper's space-time slice; below, a row of frames."""
    side = film.shape[1]
    chosen = np.linspace(0, len(film), _STRIP, endpoint=False).astype(int)
    row = int(film[chosen].std(axis=0).mean(axis=(1, 2)).argmax())  # the row in which most moves
    marked = film[0].copy()
    marked[row, ::8] = (200, 40, 40)
    times = np.linspace(0, len(film) - 1, side).round().astype(int)
    above = np.concatenate([marked, film[times, row]], axis=1)  # [side, 2 side, 3]
    small = 2 * side // _STRIP
    below = [np.asarray(Image.fromarray(film[n]).resize((small, small), Image.Resampling.LANCZOS)) for n in chosen]
    return np.concatenate([above, np.concatenate(below, axis=1)])


def _bounding_points(cloud: GaussianCloud) -> Float32[np.ndarray, "M 3"]:
    """Points that a picture must contain: the centres of the Gaussians, extended by their usual size [m]."""
    sigma = cloud.scales.max(axis=1, keepdims=True)
    reach = np.minimum(sigma, np.quantile(sigma, _MOST).astype(np.float32))
    return np.concatenate([cloud.means - reach, cloud.means + reach])


def _footprint(points: Float32[np.ndarray, "G 3"]) -> tuple[Float32[np.ndarray, "2"], float]:
    """Centre of the points seen from above, and the radius of a ball around them [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    return (low[:2] + high[:2]) / np.float32(2), max(float(np.linalg.norm(high - low)) / 2, 1e-6)
