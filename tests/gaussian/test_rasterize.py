"""The picture of a cloud: against the slow exact one, and by laws of its own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud, join_clouds
from dynamictree.gaussian.deform import Pose, apply_pose
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.gaussian.rasterize import draw, render_cloud
from dynamictree.gaussian.rasterize_kernel import MIN_ALPHA
from dynamictree.render.camera import Camera
from dynamictree.rotation import matrix_quaternions, quaternion_products
from tests.clouds import cloud_at
from tests.gaussian.slow_splat import draw_slowly, leaves_of


@pytest.fixture(scope="module")
def cloud() -> GaussianCloud:
    rng = np.random.default_rng(3)
    count = 400
    quaternions = rng.normal(size=(count, 4))
    return cloud_at(
        rng.normal(size=(count, 3)) * 0.6,
        turned=quaternions,
        scale=np.exp(rng.normal(size=(count, 3)) * 0.7 - 3),
        opacity=rng.uniform(0.1, 1, count),
        sh=rng.normal(size=(count, 16, 3)) * 0.4,
    )


@pytest.fixture(scope="module")
def camera() -> Camera:
    return Camera.look_at(np.array([0.5, -4.0, 0.7]), np.zeros(3))


def decibels(picture: np.ndarray, expected: np.ndarray) -> float:
    return float(-10 * np.log10(max(np.square(picture - expected).mean(), 1e-20)))


@pytest.mark.parametrize("size", [(96, 80), (53, 41)])
def test_fast_and_slow_pictures_agree(cloud: GaussianCloud, camera: Camera, size: tuple[int, int]) -> None:
    width, height = size
    fast = draw(cloud, camera, width=width, height=height).picture
    slow, whole = (
        draw_slowly(leaves_of(cloud), camera, width=width, height=height, min_alpha=min_alpha).numpy()
        for min_alpha in (MIN_ALPHA, 0.0)
    )
    assert decibels(fast[..., :3], slow[..., :3]) > 80
    assert decibels(fast[..., 4], slow[..., 4]) > 80
    seen = slow[..., 4] < 0.95
    np.testing.assert_allclose(fast[seen, 3] / (1 - fast[seen, 4]), slow[seen, 3] / (1 - slow[seen, 4]), rtol=1e-3)
    assert decibels(fast[..., :3], whole[..., :3]) > 45
    assert decibels(fast[..., 4], whole[..., 4]) > 45


def one(scale: float, *, at: tuple[float, ...] = (0, 0, 0)) -> GaussianCloud:
    return cloud_at(np.array([at]), scale=scale, opacity=1, sh=np.full((1, 1, 3), 0.5 / SH_0))


def test_a_gaussian_is_where_the_camera_projects_it(camera: Camera) -> None:
    point = np.array([[0.3, 0.2, 0.4]])
    picture = render_cloud(one(0.05, at=(0.3, 0.2, 0.4)), camera, width=120, height=90)
    rows, columns = np.mgrid[:90, :120] + 0.5
    total = picture.alpha.sum()
    x, y, depth = camera.project(point, 120, 90)[0]
    np.testing.assert_allclose(
        [(picture.alpha * columns).sum() / total, (picture.alpha * rows).sum() / total], [x, y], atol=0.05
    )
    np.testing.assert_allclose(picture.depth[int(y), int(x)], depth, rtol=1e-5)
    assert np.isinf(picture.depth[0, 0])


def test_what_is_behind_or_beside_the_camera_is_not_seen(camera: Camera) -> None:
    picture = render_cloud(join_clouds([one(0.1, at=(0, -9, 0)), one(0.1, at=(50, 0, 0))]), camera, width=64, height=64)
    assert picture.alpha.max() == 0
    np.testing.assert_array_equal(picture.over((0.2, 0.4, 0.6))[0, 0], [51, 102, 153])


def test_antialiasing_keeps_the_light_of_what_is_small(camera: Camera) -> None:
    """Seen from so far that it is a seventh of a pixel, a Gaussian's light falls with its area, as it should."""
    small = one(0.005)
    light = render_cloud(small, camera, width=64, height=64).alpha.sum()
    focal = camera.intrinsics_px(64, 64)[0, 0]
    expected = 2 * np.pi * (0.005 * focal / np.linalg.norm(camera.position_m)) ** 2  # integral of the sharp one [px²]
    assert abs(light - expected) < 0.5 * expected


def test_turned_back_views_show_what_turned_harmonics_show(cloud: GaussianCloud, camera: Camera) -> None:
    turn = matrix_quaternions(Rotation.from_rotvec([0.2, 1.3, -0.5]).as_matrix()[None]).astype(np.float32)
    pose = Pose(means=cloud.means, quaternions=quaternion_products(turn, cloud.quaternions), scales=cloud.scales)
    in_renderer = render_cloud(cloud, camera, width=80, height=64, pose=pose)
    as_written = render_cloud(apply_pose(cloud, pose), camera, width=80, height=64)
    assert decibels(in_renderer.color, as_written.color) > 90
    not_turned = render_cloud(replace(cloud, quaternions=pose.quaternions), camera, width=80, height=64)
    assert decibels(not_turned.color, as_written.color) < 40


def test_sizes_out_of_bounds_are_refused(cloud: GaussianCloud, camera: Camera) -> None:
    for width, height in ((0, 10), (10_000, 10_000)):
        with pytest.raises(InputError, match="the picture is"):
            render_cloud(cloud, camera, width=width, height=height)
