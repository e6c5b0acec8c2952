"""Preview of a moving splat as one still picture, with the same layout as for a mesh."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32, UInt8

from dynamictree.export.moving_tree import MovingTree, Report
from dynamictree.export.splat_scene import SplatScene
from dynamictree.gaussian.animate import AnimatedSplat
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.deform import Deformer
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.render.camera import Camera
from dynamictree.render.contact_sheet import (
    NUM_STRIP,
    STILL_PX,
    STRIP_PX,
    SWAY_PX,
    ContactSheet,
    amplitude_colors,
    sway_amplitude,
)


def splat_sheet(tree: MovingTree, binding: Binding, report: Report) -> UInt8[np.ndarray, "A B 3"]:
    """Draw one picture, the amplitude of the sway in colours, and frames in a row."""
    scene = SplatScene.of(binding, ground=tree.params.shot.ground)
    num_frames = tree.spectrum.num_frames
    splat = AnimatedSplat(
        binding=scene.binding, coefficients=tree.coefficients, num_frames=num_frames, fps=tree.spectrum.fps
    )
    deformer, camera = Deformer(scene.binding), _camera(tree, scene, 1.0)
    rest = deformer.pose(splat.displacement(0.0))
    amplitude = _gaussian_amplitudes(scene.binding, sway_amplitude(tree.coefficients, num_frames))
    moving = scene.binding.moving
    still = scene.picture(camera, STILL_PX, rest, scene.backdrop(camera, STILL_PX))
    report(0.3)
    small = _camera(tree, scene, STRIP_PX[0] / STRIP_PX[1])
    backdrop = scene.backdrop(small, STRIP_PX)
    phases = np.arange(NUM_STRIP) / NUM_STRIP
    strip = [scene.picture(small, STRIP_PX, deformer.pose(frame), backdrop) for frame in splat.displacements(phases)]
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
