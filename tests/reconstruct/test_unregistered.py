"""Whoever loses a photo reads why."""

import numpy as np
import pycolmap
import pytest

from dynamictree.reconstruct.mapping import failure_reasons, leave_out_unreliable


@pytest.fixture
def database(tmp_path):
    """Six photos of 300 points, one with 500 features of nothing that the others show, and a dark one."""
    with pycolmap.Database.open(tmp_path / "features.db") as database:
        pycolmap.synthesize_dataset(six_photos(num_points=300), database)
        camera_id = database.read_all_cameras()[0].camera_id
        for name, number in (("stranger.png", 500), ("dark.png", 3)):
            image_id = database.write_image(pycolmap.Image(name=name, camera_id=camera_id))
            database.write_keypoints(image_id, np.random.default_rng(0).random((number, 2)).astype(np.float32))
        yield database


def six_photos(num_points: int) -> pycolmap.SyntheticDatasetOptions:
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 6
    options.num_points3D = num_points
    return options


def test_each_photo_without_a_camera_has_its_reason(database: pycolmap.Database) -> None:
    names = [image.name for image in database.read_all_images()]
    placed = set(names) - {names[0], "stranger.png", "dark.png"}
    sentences = failure_reasons(database, placed)
    assert set(sentences) == set(names) - placed
    assert "it has 3 features" in sentences["dark.png"]
    assert "it shares 0 points" in sentences["stranger.png"]
    assert "fits at no place" in sentences[names[0]]


@pytest.mark.parametrize(("away", "stays"), [(5, True), (100, False)])
def test_a_camera_that_flew_away_is_none(away: int, stays: bool) -> None:
    model = pycolmap.synthesize_dataset(six_photos(num_points=300))
    places = {image.name: image.projection_center() for image in model.images.values()}
    one = next(iter(model.images.values()))
    spread = np.median(np.linalg.norm(list(places.values()) - np.median(list(places.values()), axis=0), axis=1))
    pose = one.cam_from_world()
    there = one.projection_center() + away * spread * np.array([1.0, 0, 0])
    model.frame(one.frame_id).set_cam_from_world(
        one.camera_id, pycolmap.Rigid3d(pose.rotation, -pose.rotation.matrix() @ there)
    )
    leave_out_unreliable(model)
    assert {image.name for image in model.images.values() if image.has_pose} == set(places) - (
        set() if stays else {one.name}
    )
