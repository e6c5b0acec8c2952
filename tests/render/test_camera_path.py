import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.render import Backdrop, cameras_of, spooled
from dynamictree.requests import Shot


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


@pytest.mark.parametrize(
    ("options", "message"),
    [({"side_px": 63}, "side_px is 63"), ({"azimuth_deg": 400.0}, "azimuth"), ({"elevation_deg": 85.0}, "elevation")],
)
def test_a_shot_out_of_bounds_is_reported(options: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Shot(**options)


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
    with spooled(iter(frames)) as film:
        np.testing.assert_array_equal(film, frames)
    with pytest.raises(InputError, match="no frames"), spooled(iter([])):
        pass
