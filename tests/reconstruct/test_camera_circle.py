"""Which way photos look at the plant, and the sides that none shows."""

import numpy as np

from dynamictree.reconstruct.camera_circle import camera_circle, circle_picture, coverage_warnings
from dynamictree.render.camera import Camera


def orbit(azimuths_deg: np.ndarray, elevation_deg: float = 15.0) -> dict[str, Camera]:
    turn, up = np.radians(azimuths_deg), np.radians(elevation_deg)
    target = np.array([0.4, -0.2, 1.0])
    away = np.stack([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.full(len(turn), np.sin(up))], axis=1)
    return {f"{row:02d}.jpg": Camera.look_at(target + 3 * direction, target) for row, direction in enumerate(away)}


def test_photos_all_around_have_no_warning() -> None:
    circle = camera_circle(orbit(np.arange(0.0, 360.0, 15.0)))
    assert np.isclose(circle.largest_gap_deg, 15)
    assert coverage_warnings(circle, 24, 24) == []


def test_a_gap_is_said_with_the_photos_beside_it() -> None:
    """A film lost seven neighbouring frames, a quarter of the circle, without a word."""
    turns = np.arange(0.0, 360.0, 12.0)
    registered = np.delete(turns, np.arange(10, 17))  # 108 to 204 degrees are left without
    circle = camera_circle(orbit(registered))
    assert np.isclose(circle.largest_gap_deg, 96)
    assert circle.beside_gap == ("09.jpg", "10.jpg")
    [warning] = coverage_warnings(circle, len(registered), len(turns))
    assert "96 degrees of the circle, between 09.jpg and 10.jpg" in warning


def test_lost_photos_are_said() -> None:
    """Eight of 24 photos made black fog, and the warnings were empty."""
    circle = camera_circle(orbit(np.arange(0.0, 360.0, 45.0)))
    lost, gap = coverage_warnings(circle, 8, 24)
    assert lost.startswith("8 of 24 photos have a camera")
    assert "45 degrees" in gap
    assert coverage_warnings(camera_circle(orbit(np.arange(0.0, 360.0, 15.0))), 24, 36) == []


def test_a_camera_above_the_plant_fills_no_gap() -> None:
    above = {"above.jpg": Camera.look_at(np.array([0.3, -0.2, 4.0]), np.array([0.4, -0.2, 1.0]))}
    circle = camera_circle(orbit(np.arange(0.0, 181.0, 20.0)) | above)
    assert "above.jpg" not in circle.photos
    assert np.isclose(circle.largest_gap_deg, 180, atol=2)


def test_the_drawing_is_red_where_photos_are_missing() -> None:
    picture = circle_picture(camera_circle(orbit(np.arange(0.0, 271.0, 15.0))), 200).astype(int)
    reddish = (picture[..., 0] > 200) & (picture[..., 1] < 230)
    lower_right, upper_left = (
        reddish[110:150, 110:150],
        reddish[50:90, 50:90],
    )  # azimuths 270 to 360 are at the lower right
    assert lower_right.mean() > 0.7
    assert not upper_left.any()
