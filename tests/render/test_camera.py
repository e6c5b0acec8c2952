import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.render import Backdrop, Camera, cameras_of, stored_frames
from dynamictree.requests import Shot


def test_orbit_at_zero_shows_x_to_the_right_and_z_up():
    camera = Camera.orbit(np.array([[-1.0, -1, 0], [1, 1, 3]]), azimuth_deg=0.0)
    middle, right, up, back = camera.project(np.array([[0.0, 0, 1.5], [1, 0, 1.5], [0, 0, 2.5], [0, 1, 1.5]]), 200, 100)
    assert right[0] > middle[0]
    assert up[1] < middle[1]
    assert up[0] == pytest.approx(middle[0], abs=1e-9)
    assert back[2] > middle[2]


def test_orbit_turns_anticlockwise_seen_from_above():
    points = np.array([[-1.0, -1, -1], [1, 1, 1]])
    positions = np.array(
        [Camera.orbit(points, azimuth_deg=a, elevation_deg=0.0).position_m for a in (0.0, 90.0, 180.0, 270.0)]
    )
    directions = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    assert np.allclose(directions, [[0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]], atol=1e-9)


def test_z_stays_up_from_every_side():
    points = np.array([[-1.0, -2, 0], [1, 2, 4]])
    for azimuth in (0.0, 45.0, 130.0, 200.0, 315.0):
        camera = Camera.orbit(points, azimuth_deg=azimuth, elevation_deg=20.0)
        low, high = camera.project(np.array([[0.0, 0, 1], [0, 0, 3]]), 100, 100)
        assert high[1] < low[1] - 10
        assert camera.world_to_camera[0, 2] == pytest.approx(0, abs=1e-12)  # the horizon is level
        assert np.allclose(camera.world_to_camera @ camera.world_to_camera.T, np.eye(3))
        assert np.linalg.det(camera.world_to_camera) == pytest.approx(1)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_orbit_holds_all_points_as_tightly_as_it_can(rng, aspect):
    points = rng.normal(size=(200, 3)) * [1, 2, 5]
    width = int(200 * aspect)
    x, y, depth = (
        Camera.orbit(points, azimuth_deg=33.0, elevation_deg=25.0, aspect=aspect).project(points, width, 200).T
    )
    reach = np.maximum(np.abs(x / width - 0.5), np.abs(y / 200 - 0.5)).max()
    assert 0.45 < reach <= 0.5
    assert (depth > 0).all()


@pytest.mark.parametrize("shot", [Shot(), Shot(orbit=True), Shot(orbit=True, elevation_deg=60.0, azimuth_deg=200.0)])
def test_every_picture_holds_all_points(shot: Shot, rng) -> None:
    points = rng.normal(size=(500, 3)) * [1, 2, 3] + [10, -5, 2]
    cameras = cameras_of(shot, points, 7)
    assert len(cameras) == 7
    for camera in cameras:
        x, y, depth = camera.project(points, 100, 100).T
        assert 0 <= min(x.min(), y.min()) <= max(x.max(), y.max()) <= 100
        assert (depth > 0).all()


def test_a_camera_that_goes_around_stays_as_far(rng) -> None:
    points = rng.normal(size=(500, 3)) * [1, 2, 3]
    places = np.stack([camera.position_m for camera in cameras_of(Shot(orbit=True), points, 12)])
    middle = places.mean(axis=0)
    radii = np.linalg.norm(places - middle, axis=1)
    assert np.ptp(radii) < 0.01 * radii.mean()


def test_a_shadow_lies_where_the_sun_puts_it() -> None:
    camera = cameras_of(Shot(elevation_deg=40.0), np.array([[-1, -1, 0], [1, 1, 2.0]]), 1)[0]
    backdrop = Backdrop(camera, size_px=(64, 64), ground_m=0.0, centre_m=np.zeros(2), radius_m=1.5)
    covered = np.full(2, 0.01, np.float32)
    shadow = backdrop.shadow(np.array([[0, 0, 0], [0, 0, 0.95]], np.float32), covered)
    assert np.isclose(shadow.sum() * (2 * 2.2 * 1.5 / 160) ** 2, 0.02, rtol=1e-3)  # no light is lost twice
    low = np.argwhere(shadow > 0.5 * shadow.max()).astype(float) * (2 * 2.2 * 1.5 / 160) - 2.2 * 1.5
    assert np.abs(low - [0, 0]).max(axis=1).min() < 0.1
    assert np.abs(low - [0.40, 0.45]).max(axis=1).min() < 0.1
    bare, shaded = backdrop.picture(), backdrop.picture(np.zeros((1, 3), np.float32), np.ones(1, np.float32))
    assert 0 < (shaded < bare - 0.1).all(axis=2).sum() < 200
    assert (shaded <= bare + 1e-6).all()


def test_a_spool_gives_back_every_picture(rng) -> None:
    frames = rng.integers(0, 255, (5, 4, 6, 3), dtype=np.uint8)
    with stored_frames(iter(frames)) as film:
        np.testing.assert_array_equal(film, frames)
    with pytest.raises(InputError, match="no frames"), stored_frames(iter([])):
        pass
