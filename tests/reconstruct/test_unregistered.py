"""Whoever loses a photo reads why, and no photo has a wrong camera."""

import numpy as np
import pycolmap
import pytest

from dynamictree.reconstruct import mapping
from dynamictree.reconstruct.mapping import disagreeing_photos, failure_reasons, leave_out_unreliable
from dynamictree.reconstruct.photos import Photo


@pytest.fixture
def database(tmp_path):
    """Six photos of 300 points, one with 500 features of nothing that the others show, and a dark one."""
    with pycolmap.Database.open(tmp_path / "features.db") as database:
        pycolmap.synthesize_dataset(six_photos(), database)
        camera_id = database.read_all_cameras()[0].camera_id
        for name, number in (("stranger.png", 500), ("dark.png", 3)):
            image_id = database.write_image(pycolmap.Image(name=name, camera_id=camera_id))
            database.write_keypoints(image_id, np.random.default_rng(0).random((number, 2)).astype(np.float32))
        yield database


def six_photos() -> pycolmap.SyntheticDatasetOptions:
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 1, 6, 300
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
    model = pycolmap.synthesize_dataset(six_photos())
    one = move_one_camera(model, away)
    leave_out_unreliable(model)
    assert one.has_pose == stays
    assert model.num_reg_images() == 5 + stays


def move_one_camera(model: pycolmap.Reconstruction, away: float) -> pycolmap.Image:
    """Move a camera aside, by a multiple of the cameras' median distance from their middle."""
    one = next(iter(model.images.values()))
    places = np.array([image.projection_center() for image in model.images.values()])
    spread = np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1))
    turn = one.cam_from_world().rotation
    there = one.projection_center() + away * spread * np.array([1.0, 0, 0])
    model.frame(one.frame_id).set_cam_from_world(one.camera_id, pycolmap.Rigid3d(turn, -turn.matrix() @ there))
    return one


def test_a_wrong_camera_is_found_by_its_matches_and_sought_again(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a walk along three quarters of a circle, two photos had cameras 45° from their place."""
    photos = 6 * [Photo(source="a", name="a", width=1, height=1, focal_px=None)]
    (tmp_path / "photos").mkdir()
    search = mapping._Search(folder=tmp_path, photos=photos, given=None, part=(0.0, 1.0), threads=1)
    with pycolmap.Database.open(search.database) as database:
        model = pycolmap.synthesize_dataset(six_photos(), database)
    assert disagreeing_photos(model, search.database) == set()
    one = move_one_camera(model, 0.3)
    assert one.image_id in disagreeing_photos(model, search.database)
    first, seek = iter([{0: model}]), pycolmap.incremental_mapping
    monkeypatch.setattr(pycolmap, "incremental_mapping", lambda *all, **more: next(first, None) or seek(*all, **more))
    result = mapping._map_once(search, 0, 30, 0.25) or model
    assert result.num_reg_images() == 6
    assert disagreeing_photos(result, search.database) == set()
