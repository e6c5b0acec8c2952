"""gsplat draws what our own renderer draws."""

import numpy as np
import pytest

from benchmarks.render_frame import gaussian_tree
from dynamictree.gaussian.cuda import has_gsplat
from dynamictree.gaussian.deform import Pose
from dynamictree.gaussian.rasterize import render_cloud, render_on_cpu
from dynamictree.render.camera import Camera
from dynamictree.rotation import quaternion_products


@pytest.mark.gpu
def test_gsplat_and_the_cpu_draw_the_same_picture(rng) -> None:
    if not has_gsplat():
        pytest.skip("gsplat or a CUDA device is not there")
    cloud = gaussian_tree(20_000)
    turn = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])
    pose = Pose(
        means=cloud.means + np.float32(0.1),
        quaternions=quaternion_products(np.tile(turn, (len(cloud.means), 1)), cloud.quaternions).astype(np.float32),
        scales=cloud.scales,
    )
    camera = Camera.orbit(cloud.means)
    theirs = render_cloud(cloud, camera, width=256, height=256, pose=pose)
    ours = render_on_cpu(cloud, camera, width=256, height=256, pose=pose)
    assert np.square(theirs.color - ours.color).mean() < 1e-4  # 40 dB
    assert np.abs(theirs.alpha - ours.alpha).mean() < 0.01
    both = np.isfinite(theirs.depth) & np.isfinite(ours.depth) & (ours.alpha > 0.5)
    assert np.median(np.abs(theirs.depth[both] / ours.depth[both] - 1)) < 0.01
