"""Given poses that the photos disagree with are refined, in their own frame and scale; exact ones stay."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation
from skimage.transform import SimilarityTransform

from dynamictree.reconstruct.cameras import find_cameras
from dynamictree.reconstruct.input_cameras import InputCamera
from dynamictree.reconstruct.mapping import replace_weak_lens
from dynamictree.reconstruct.photos import list_photos, prepare_photos
from dynamictree.reconstruct.refine_poses import ENOUGH_POINTS, ENOUGH_PX, refine_poses
from dynamictree.reconstruct.views import SparseModel
from tests.reconstruct.conftest import HEIGHT, WIDTH, Orbit
from tests.reconstruct.test_input_cameras import FOCAL

NUM_PHOTOS = 8
LENS = {"model": "SIMPLE_RADIAL", "params": (FOCAL, WIDTH / 2, HEIGHT / 2, 0.0), "width": WIDTH, "height": HEIGHT}


def given_by(orbit: Orbit, rng: np.random.Generator, *, off_m: float, off_deg: float) -> list[InputCamera]:
    cameras = []
    for path, camera in zip(orbit.photos[:NUM_PHOTOS], orbit.cameras, strict=False):
        turn = Rotation.from_rotvec(np.radians(off_deg) * rng.normal(size=3)).as_matrix() @ camera.world_to_camera
        place = camera.position_m + off_m * rng.normal(size=3)
        pose = np.concatenate([turn, -(turn @ place)[:, None]], axis=1)
        cameras.append(InputCamera(photo=path.name, world_to_camera=pose, **LENS))
    return cameras


def triangulated(orbit: Orbit, given: list[InputCamera], folder: Path) -> SparseModel:
    prepared = prepare_photos(list_photos(orbit.photos[:NUM_PHOTOS]), folder / "photos")
    by_name = {camera.photo: camera for camera in given}
    return find_cameras(prepared, folder, given=[replace(by_name[photo.source]) for photo in prepared])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_wrong_poses_are_refined_and_exact_ones_stay(orbit, rng, tmp_path):
    true = np.array([camera.position_m for camera in orbit.cameras[:NUM_PHOTOS]])
    exact = triangulated(orbit, given_by(orbit, rng, off_m=0, off_deg=0), tmp_path / "exact")
    assert exact.reprojection_error_px < ENOUGH_PX
    np.testing.assert_allclose([view.camera.position_m for view in exact.views], true, atol=1e-9)

    wrong = given_by(orbit, rng, off_m=0.03, off_deg=0.4)
    model = triangulated(orbit, wrong, tmp_path / "wrong")
    assert model.reprojection_error_px < 2 * exact.reprojection_error_px  # it was 1.5 px, on a fifth of the points
    assert len(model.points) > 0.7 * len(exact.points)
    places = np.array([-camera.world_to_camera[:, :3].T @ camera.world_to_camera[:, 3] for camera in wrong])
    refined = np.array([view.camera.position_m for view in model.views])
    assert off(refined, true) < 0.6 * off(places, true)
    assert SimilarityTransform.from_estimate(refined, true).scale == pytest.approx(1, abs=0.02)  # still the given frame
    np.testing.assert_allclose(refined.mean(axis=0), true.mean(axis=0), atol=0.05)


def off(places: np.ndarray, true: np.ndarray) -> float:
    return float(np.linalg.norm(SimilarityTransform.from_estimate(places, true)(places) - true, axis=1).mean())


@pytest.mark.parametrize(("num_points", "moved"), [(ENOUGH_POINTS // 2, False), (4 * ENOUGH_POINTS, True)])
def test_few_points_move_no_camera(num_points: int, moved: bool) -> None:
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, NUM_PHOTOS
    options.num_points3D = num_points
    model = pycolmap.synthesize_dataset(options)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev, noise.rig_from_world_translation_stddev = 0.5, 0.05
    pycolmap.synthesize_noise(noise, model)
    given = {image.name: image.projection_center() for image in model.images.values()}

    def same_points(posed: pycolmap.Reconstruction, slack: float = 1.0) -> pycolmap.Reconstruction:
        posed.update_point_3d_errors()
        return posed

    result = refine_poses(same_points(model), given, same_points)
    change = [np.linalg.norm(image.projection_center() - given[image.name]) for image in result.images.values()]
    assert (max(change) > 1e-4) == moved
    assert max(change) < 1


@pytest.mark.parametrize(("bend", "straight"), [(0.0, True), (1e-5, True), (-1e-4, True), (-0.02, False)])
def test_photos_of_a_straight_lens_are_not_resampled(bend, straight):
    camera = pycolmap.Camera(**{**LENS, "params": [FOCAL, WIDTH / 2, HEIGHT / 2, bend]})
    replace_weak_lens(camera)
    of_photo = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    assert ((of_photo.width, of_photo.height) == (WIDTH, HEIGHT)) == straight
