import numpy as np
import pytest

from dynamictree.render import Camera


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


def test_a_picture_twice_as_large_shows_the_same():
    camera = Camera.look_at(np.array([3.0, -4, 2]), np.array([0.0, 0, 1]))
    points = np.array([[0.3, 0.2, 1.4]])
    small, large = camera.project(points, 100, 80), camera.project(points, 200, 160)
    assert np.allclose(large, small * [2, 2, 1])
