"""Preview of a moving splat as one still picture, laid out as that of a mesh."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, UInt8

from dynamictree.export.moving_tree import MovingTree, Report
from dynamictree.export.splat_scene import SplatScene
from dynamictree.gaussian.animate import AnimatedSplat, iter_poses
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.deform import Deformer
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.render.camera import Camera
from dynamictree.render.contact_sheet import (
    HALF_PX,
    NUM_STRIP,
    SIDE_PX,
    STILL_PX,
    STRIP_PX,
    ContactSheet,
    amplitude_colors,
    slice_phases,
    slice_window,
    sway_amplitude,
)


def splat_sheet(tree: MovingTree, binding: Binding, report: Report) -> UInt8[np.ndarray, "A B 3"]:
    """One picture, the amplitude of the sway in colours, a line of pixels stacked over time, frames in a row."""
    scene = SplatScene.of(binding, ground=tree.params.shot.ground)
    num_frames = tree.spectrum.num_frames
    splat = AnimatedSplat(
        binding=scene.binding, coefficients=tree.coefficients, num_frames=num_frames, fps=tree.spectrum.fps
    )
    deformer, camera = Deformer(scene.binding), _camera(tree, scene, 1.0)
    rest, still_px = deformer.pose(splat.displacement(0.0)), (STILL_PX, STILL_PX)
    amplitude = _of_gaussians(scene.binding, sway_amplitude(tree.coefficients, num_frames))
    moving = scene.binding.moving
    line, window = slice_window(scene.binding.cloud.means[moving], amplitude[moving], camera)
    still = scene.picture(camera, still_px, rest, scene.backdrop(camera, still_px))
    report(0.3)
    small = _camera(tree, scene, STRIP_PX[0] / STRIP_PX[1])
    backdrop = scene.backdrop(small, STRIP_PX)
    phases = np.arange(NUM_STRIP) / NUM_STRIP
    strip = [scene.picture(small, STRIP_PX, deformer.pose(frame), backdrop) for frame in splat.displacements(phases)]
    report(0.6)
    standing = f" ({np.count_nonzero(~moving):,} stand still)" if not moving.all() else ""
    sheet = ContactSheet(
        still=still,
        sway=_sway_picture(scene, amplitude, _camera(tree, scene, SIDE_PX / HALF_PX)),
        time_slice=_space_time_slice(scene, splat, amplitude, window),
        strip=np.concatenate(strip, axis=1),
        line=line,
        title=f"{binding.cloud.num_gaussians:,} Gaussians{standing}, {tree.mesh.height_text} high",
        most_m=float(amplitude.max()),
        some_stand=not moving.all(),
        num_frames=num_frames,
    )
    return sheet.picture()


def _camera(tree: MovingTree, scene: SplatScene, aspect: float) -> Camera:
    shot = tree.params.shot
    return Camera.orbit(scene.bounds, azimuth_deg=shot.azimuth_deg, elevation_deg=shot.elevation_deg, aspect=aspect)


def _of_gaussians(binding: Binding, amplitude: Float32[np.ndarray, " N"]) -> Float32[np.ndarray, " G"]:
    """The amplitude of each Gaussian's place on its face [m]; 0 where it stands still."""
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
    size_px = (SIDE_PX, HALF_PX)
    pose = Deformer(colored.binding).pose(np.zeros_like(colored.binding.vertices))
    return colored.picture(camera, size_px, pose, scene.backdrop(camera, size_px), shadow=False)


def _space_time_slice(
    scene: SplatScene, splat: AnimatedSplat, amplitude: Float32[np.ndarray, " G"], window: Camera
) -> UInt8[np.ndarray, "T W 3"]:
    """The middle row of the window over one loop; only Gaussians that may be seen there are moved and drawn."""
    sigmas = 3.0  # so far from its middle a Gaussian is seen
    slice_rows = 8  # of each picture of the slice, of which the middle one is stacked
    cloud = scene.binding.cloud
    _, y, depth = window.project(cloud.means.astype(np.float64), SIDE_PX, SIDE_PX).T
    reach_px = (sigmas * (cloud.scales.max(axis=1) + amplitude)) * window.focal * SIDE_PX / np.maximum(depth, 1e-9)
    near = (depth > 0) & (np.abs(y - SIDE_PX / 2) < reach_px + slice_rows)
    binding = replace(
        scene.binding,
        cloud=cloud.subset(near),
        face_of=scene.binding.face_of[near],
        weights=scene.binding.weights[near],
    )
    few = replace(scene, binding=binding, covered_m2=scene.covered_m2[near[scene.binding.moving]])
    shrink = SIDE_PX / slice_rows
    centre = (window.centre[0], (window.centre[1] - 0.5) * shrink + 0.5)
    flat = replace(window, focal=window.focal * shrink, centre=centre)
    size_px = (SIDE_PX, slice_rows)
    backdrop = scene.backdrop(flat, size_px)
    frames = splat.displacements(slice_phases(splat.num_frames))
    poses = iter_poses(binding, frames)
    rows = [few.picture(flat, size_px, pose, backdrop, shadow=False)[slice_rows // 2] for pose in poses]
    return np.stack(rows)
