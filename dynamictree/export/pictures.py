"""Pictures and films of a moving mesh or splat."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import BinaryIO

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from dynamictree.color import STILL_SHARE, greyed, linear_to_srgb
from dynamictree.export.moving_tree import MovingTree, Report
from dynamictree.gaussian.animate import iter_poses, reduced_splat
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.cloud import GaussianCloud, area_m2
from dynamictree.gaussian.deform import Deformer, Pose
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.render import Backdrop, Renderer, RenderSettings, draw_contact_sheet, write_png
from dynamictree.render.camera import Camera, cameras_of, points_in_view
from dynamictree.render.contact_sheet import (
    NUM_STRIP,
    STILL_PX,
    STRIP_PX,
    SWAY_PX,
    ContactSheet,
    amplitude_colors,
    sway_amplitude,
)
from dynamictree.render.video import Picture
from dynamictree.spectrum import iter_motion


@dataclass(frozen=True, kw_only=True)
class SplatScene:
    """A bound splat over a floor, ready to be drawn."""

    binding: Binding
    bounds: Float32[np.ndarray, "M 3"]  # points that a picture must contain [m]
    covered_m2: Float32[np.ndarray, " moving"]  # area that each moving Gaussian shades
    ground: bool  # whether there is a floor

    @classmethod
    def of(cls, binding: Binding, *, ground: bool, grey_still: bool = False) -> "SplatScene":
        """Prepare a scene: large clouds at a lower level of detail, still parts in grey if `grey_still` is set."""
        # a larger cloud is drawn at a lower level of detail: 0.2 s per picture on two cores
        preview_gaussians = 200_000
        binding = reduced_splat(binding, share=min(1.0, preview_gaussians / binding.cloud.num_gaussians))
        if grey_still:
            binding = replace(binding, cloud=_grey_where(binding.cloud, ~binding.moving))
        cloud = binding.cloud
        covered = (np.pi * area_m2(cloud) * cloud.opacity)[binding.moving]
        bounds = _bounding_points(cloud.subset(points_in_view(cloud.means, binding.moving)))
        return cls(binding=binding, bounds=bounds, covered_m2=covered, ground=ground)

    def backdrop(self, camera: Camera, size_px: tuple[int, int]) -> Backdrop:
        """Return the sky and floor behind the splat, for one camera."""
        strays = 0.001  # share of the Gaussians, the lowest, that may lie below the floor
        floor = float(np.quantile(self.bounds[:, 2], strays)) if self.ground else -np.inf
        low, high = self.bounds.min(axis=0), self.bounds.max(axis=0)
        centre, radius = (low[:2] + high[:2]) / np.float32(2), max(float(np.linalg.norm(high - low)) / 2, 1e-6)
        return Backdrop(camera, size_px=size_px, ground_m=floor, centre_m=centre, radius_m=radius)

    def picture(
        self, camera: Camera, size_px: tuple[int, int], pose: Pose, backdrop: Backdrop, *, shadow: bool = True
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Draw one picture of a pose."""
        moving = self.binding.moving
        behind = backdrop.picture(pose.means[moving], self.covered_m2) if shadow and self.ground else backdrop.picture()
        width, height = size_px
        return render_cloud(self.binding.cloud, camera, width=width, height=height, pose=pose).over(behind)


def _grey_where(cloud: GaussianCloud, still: Bool[np.ndarray, " G"]) -> GaussianCloud:
    """Turn still Gaussians grey, and darken them to `STILL_SHARE`; 0.5 + Σ sh Y is a display value."""
    share = linear_to_srgb(np.array([STILL_SHARE], np.float32))
    sh = cloud.sh.copy()
    sh[still] = share * greyed(sh[still])
    sh[still, 0] -= (1 - share) * 0.5 / np.float32(SH_0)
    return replace(cloud, sh=sh)


def _bounding_points(cloud: GaussianCloud) -> Float32[np.ndarray, "M 3"]:
    """Return points that a picture must contain: the centres of the Gaussians, extended by their scales [m]."""
    most = 0.95  # quantile that limits the scales; a few Gaussians may be as large as the scene
    sigma = cloud.scales.max(axis=1, keepdims=True)
    reach = np.minimum(sigma, np.quantile(sigma, most).astype(np.float32))
    return np.concatenate([cloud.means - reach, cloud.means + reach])


def write_sheet(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write a PNG with one picture, the amplitude of the sway in colours, a space-time slice and a row of frames."""
    if tree.captured and tree.binding is not None:
        sheet = splat_sheet(tree, tree.binding, report)
    else:
        sheet = draw_contact_sheet(tree.mesh, tree.coefficients, num_frames=tree.spectrum.num_frames)
    write_png(sheet, stream)


def draw(tree: MovingTree, report: Report) -> Iterator[Picture]:
    """Draw the frames of a film: of the splat where one was captured, else of the mesh."""
    if tree.captured and tree.binding is not None:
        return _draw_splat(tree, tree.binding, report)
    return _draw_mesh(tree, report)


def _draw_mesh(tree: MovingTree, report: Report) -> Iterator[Picture]:
    shot = tree.params.shot
    look = RenderSettings(width=shot.side_px, height=shot.side_px, ground=shot.ground, grey_still=shot.grey_still)
    renderer = Renderer(tree.mesh, look)
    seen = points_in_view(tree.mesh.vertices, ~tree.mesh.still_vertices)
    cameras = cameras_of(shot, tree.mesh.vertices[seen], len(tree.phases))
    for frame, camera in zip(tree.frames(report), cameras, strict=True):
        yield renderer.picture(frame, camera=camera)


def _draw_splat(tree: MovingTree, binding: Binding, report: Report) -> Iterator[Picture]:
    """Draw the Gaussians over a floor with their shadow and a sky."""
    shot, side = tree.params.shot, tree.params.shot.side_px
    scene = SplatScene.of(binding, ground=shot.ground, grey_still=shot.grey_still)
    behind: tuple[Camera, Backdrop] | None = None
    poses = iter_poses(scene.binding, tree.frames(report), tree.leaf_turns())
    for pose, camera in zip(poses, cameras_of(shot, scene.bounds, len(tree.phases)), strict=True):
        if behind is None or behind[0] is not camera:
            behind = (camera, scene.backdrop(camera, (side, side)))
        yield scene.picture(camera, (side, side), pose, behind[1])


def splat_sheet(tree: MovingTree, binding: Binding, report: Report) -> UInt8[np.ndarray, "A B 3"]:
    """Draw one picture, the amplitude of the sway in colours, and frames in a row."""
    scene = SplatScene.of(binding, ground=tree.params.shot.ground)
    num_frames, coefficients = tree.spectrum.num_frames, tree.coefficients
    deformer, camera = Deformer(scene.binding), _camera(tree, scene, 1.0)
    rest = deformer.pose(next(iter_motion(coefficients, np.zeros(1), num_frames)))
    amplitude = _gaussian_amplitudes(scene.binding, sway_amplitude(coefficients, num_frames))
    moving = scene.binding.moving
    still = scene.picture(camera, STILL_PX, rest, scene.backdrop(camera, STILL_PX))
    report(0.3)
    small = _camera(tree, scene, STRIP_PX[0] / STRIP_PX[1])
    backdrop = scene.backdrop(small, STRIP_PX)
    phases = np.arange(NUM_STRIP) / NUM_STRIP
    frames = iter_motion(coefficients, phases, num_frames)
    strip = [scene.picture(small, STRIP_PX, deformer.pose(frame), backdrop) for frame in frames]
    report(0.6)
    standing = f" ({np.count_nonzero(~moving):,} stand still)" if not moving.all() else ""
    sheet = ContactSheet(
        still=still,
        sway=_sway_picture(scene, amplitude, _camera(tree, scene, SWAY_PX[0] / SWAY_PX[1])),
        strip=np.concatenate(strip, axis=1),
        title=f"{binding.cloud.num_gaussians:,} Gaussians{standing}, {tree.mesh.height_text} high",
        most_m=float(amplitude.max()),
        some_stand=not moving.all(),
        num_frames=num_frames,
    )
    return sheet.picture()


def _camera(tree: MovingTree, scene: SplatScene, aspect: float) -> Camera:
    shot = tree.params.shot
    return Camera.orbit(scene.bounds, azimuth_deg=shot.azimuth_deg, elevation_deg=shot.elevation_deg, aspect=aspect)


def _gaussian_amplitudes(binding: Binding, amplitude: Float32[np.ndarray, " N"]) -> Float32[np.ndarray, " G"]:
    """Return the amplitude at each Gaussian's place on its face [m]; 0 where it stands still."""
    result, moving = np.zeros(binding.cloud.num_gaussians, np.float32), binding.moving
    corners = amplitude[binding.triangles[binding.face_of[moving]]]
    result[moving] = (corners * binding.weights[moving]).sum(axis=1)
    return result


def _sway_picture(
    scene: SplatScene, amplitude: Float32[np.ndarray, " G"], camera: Camera
) -> UInt8[np.ndarray, "H W 3"]:
    colors = amplitude_colors(amplitude, ~scene.binding.moving)[:, :3].astype(np.float32) / 255
    cloud = replace(scene.binding.cloud, sh=((colors - 0.5) / np.float32(SH_0))[:, None])
    colored = replace(scene, binding=replace(scene.binding, cloud=cloud))
    pose = Deformer(colored.binding).pose(np.zeros_like(colored.binding.vertices))
    return colored.picture(camera, SWAY_PX, pose, scene.backdrop(camera, SWAY_PX), shadow=False)
