"""Structure from motion with pycolmap (BSD): `python -m dynamictree.reconstruct.mapping`, with a job on stdin.

Its native code cannot be interrupted, so the caller ends the whole process. Progress goes to stdout, one JSON array
per line: step, done, total, and the interval of the total progress that this search covers, as two shares.
"""

import ctypes
import json
import os
import resource
import shutil
import signal
import sys
from collections.abc import Container, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from dynamictree.reconstruct.cameras import pairs_to_match
from dynamictree.reconstruct.input_cameras import InputCamera
from dynamictree.reconstruct.marker_detection import MarkerFinder, Sighting, placed_markers
from dynamictree.reconstruct.photos import Photo
from dynamictree.reconstruct.refine_poses import refine_poses

DATABASES = ("features.db", "features-whole.db")
"""Databases of features within masks (everywhere if there are none), and of features everywhere despite masks."""
MAX_MEMORY_BYTES = 12 * 2**30
_SEED = 1
_GOOD_SHARE, _POOR_SHARE = 0.9, 0.5  # [share of the photos]
_POINT_THRESHOLDS = (  # options of COLMAP's triangulation
    *("create_max_angle_error", "continue_max_angle_error"),
    *("merge_max_reproj_error", "complete_max_reproj_error"),
)
_MAX_DISTANCE = 30  # [median distance of the cameras from their middle]; a camera farther away is wrong


def map_photos(folder: Path, photos: list[Photo], given: list[InputCamera] | None) -> None:
    """Register and undistort the photos in `photos/`: write `undistorted/`, `points.npz` and, last, `views.json`.

    Features are detected within masks first, since a plant on a turntable moves against its background. If most photos
    cannot be registered so, as with thin stems, they are detected everywhere.
    """
    masked = [photo.name for photo in photos if photo.masked]
    most = 0.9 if given is None and masked else 1.0  # share of the progress: a second search is rare
    search = _Search(folder=folder, photos=photos, given=given, part=(0.0, most))
    model = search.model()
    if given is None and masked and (model is None or model.num_reg_images() < _POOR_SHARE * len(photos)):
        unmasked = [replace(photo, masked=False) for photo in photos]
        whole_search = replace(search, photos=unmasked, part=(most, 1.0), database_name=DATABASES[1])
        whole = whole_search.model()
        if model is None or (whole is not None and whole.num_reg_images() > model.num_reg_images()):
            model, search = whole, whole_search
    if model is not None:
        _write_model(search, model, masked)


@dataclass(frozen=True, kw_only=True)
class _Search:
    """Search for cameras; its database stores features and matches, so an interrupted search continues."""

    folder: Path
    photos: list[Photo]
    given: list[InputCamera] | None
    part: tuple[float, float]
    database_name: str = DATABASES[0]
    threads: int = field(default_factory=lambda: len(os.sched_getaffinity(0)))

    @property
    def database(self) -> Path:
        return self.folder / self.database_name

    @property
    def images(self) -> Path:
        return self.folder / "photos"

    def tell(self, step: str, done: int, total: int) -> None:
        sys.stdout.write(json.dumps([step, done, total, *self.part]) + "\n")
        sys.stdout.flush()

    def model(self) -> pycolmap.Reconstruction | None:
        _extract(self)
        _match(self)
        return _map(self) if self.given is None else _with_points(self, self.given)


def _match(search: _Search) -> None:
    pairs_at_once = 12
    photos = search.photos
    pairs = pairs_to_match(len(photos))
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = search.threads
    for first in range(0, len(pairs), pairs_at_once):
        search.tell("matches", first, len(pairs))
        chunk = pairs[first : first + pairs_at_once]
        listing = search.folder / "pairs.txt"
        listing.write_text("".join(f"{photos[i].name} {photos[j].name}\n" for i, j in chunk))
        pairing = pycolmap.ImportedPairingOptions(match_list_path=str(listing))
        pycolmap.match_image_pairs(search.database, matching, pairing)
    search.tell("matches", len(pairs), len(pairs))


def _extract(search: _Search) -> None:
    """Detect SIFT features; photos of the same size and focal length, or of one known lens, share a camera."""
    max_features = 6000
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = search.threads
    extraction.sift.max_num_features = max_features
    cameras_by_name = {camera.photo: camera for camera in search.given or ()}
    done = _camera_ids(search.database)  # cameras of an interrupted search
    for photo, names in _camera_groups(search.photos, cameras_by_name):
        reader = _reader(search, photo, cameras_by_name.get(photo.name))
        missing = [name for name in names if name not in done]
        while missing:
            search.tell("features", len(done), len(search.photos))
            shared = next((done[name] for name in names if name in done), None)
            if shared is not None:
                reader.existing_camera_id = shared
            chunk = missing[: 1 if shared is None else search.threads]
            single = pycolmap.CameraMode.SINGLE
            pycolmap.extract_features(search.database, search.images, chunk, single, reader, extraction)
            missing = missing[len(chunk) :]
            done = _camera_ids(search.database)
    search.tell("features", len(search.photos), len(search.photos))


def _camera_ids(database: Path) -> dict[str, int]:
    """Return the camera of each image whose features are stored, by the image's name."""
    with pycolmap.Database.open(database) as opened:
        return {
            image.name: image.camera_id
            for image in opened.read_all_images()
            if opened.exists_descriptors(image.image_id)
        }


def _reader(search: _Search, photo: Photo, camera: InputCamera | None) -> pycolmap.ImageReaderOptions:
    reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
    if photo.masked:
        reader.mask_path = search.images  # COLMAP's name of a mask: `name.png`; no features where it is black
    if camera is not None:
        reader.camera_model = camera.model
        reader.camera_params = ",".join(str(value) for value in camera.params)
    elif photo.focal_px is not None:
        values = (photo.focal_px, photo.width / 2, photo.height / 2, 0.0)
        reader.camera_params = ",".join(str(value) for value in values)
    return reader


def _camera_groups(photos: list[Photo], cameras_by_name: dict[str, InputCamera]) -> Iterator[tuple[Photo, list[str]]]:
    groups: dict[tuple[object, ...], list[Photo]] = {}
    for photo in photos:
        camera = cameras_by_name.get(photo.name)
        lens = None if camera is None else (camera.model, *camera.params)
        alike = photo.width, photo.height, photo.focal_px, photo.masked, lens
        groups.setdefault(alike, []).append(photo)
    for group in groups.values():
        yield group[0], [photo.name for photo in group]


def _map(search: _Search) -> pycolmap.Reconstruction | None:
    """Return the model with most photos, found with COLMAP's thresholds or, if they leave out many, with lower ones."""
    # COLMAP's defaults, then lower ones, which register 14 instead of 8 of an orbit's 16 photos
    pose_inliers = ((30, 0.25), (15, 0.1))
    best = None
    for attempt, (min_inliers, min_ratio) in enumerate(pose_inliers):
        models = _map_once(search, attempt, min_inliers, min_ratio), best
        best = max(filter(None, models), key=pycolmap.Reconstruction.num_reg_images, default=None)
        if best is not None and best.num_reg_images() >= _GOOD_SHARE * len(search.photos):
            break
    return best


def _with_points(search: _Search, given: list[InputCamera]) -> pycolmap.Reconstruction:
    """Refine the given cameras where the photos disagree with them, and triangulate the matches that fit."""
    search.tell("cameras", 0, 1)
    model = pycolmap.Reconstruction()
    poses = {camera.photo: camera.world_to_camera for camera in given}
    with pycolmap.Database.open(search.database) as database:
        for camera in database.read_all_cameras():
            model.add_camera_with_trivial_rig(camera)
        for seen in database.read_all_images():
            image = pycolmap.Image(name=seen.name, camera_id=seen.camera_id, image_id=seen.image_id)
            model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(poses[seen.name]))
    sparse = search.folder / "sparse"
    sparse.mkdir(exist_ok=True)

    def triangulated(posed: pycolmap.Reconstruction, slack: float = 1.0) -> pycolmap.Reconstruction:
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads, options.random_seed = search.threads, _SEED
        options.mapper.filter_max_reproj_error *= slack
        for name in _POINT_THRESHOLDS:
            setattr(options.triangulation, name, slack * getattr(options.triangulation, name))
        result: pycolmap.Reconstruction = pycolmap.triangulate_points(
            posed, search.database, search.images, sparse, options=options
        )
        return result

    positions = {name: -pose[:, :3].T @ pose[:, 3] for name, pose in poses.items()}
    result = refine_poses(triangulated(model), positions, triangulated)
    search.tell("cameras", 1, 1)
    return result


def leave_out_unreliable(model: pycolmap.Reconstruction) -> None:
    """Remove photos that see few points, or whose camera is far from the others: their poses are unreliable."""
    least_points = 50  # points that a photo must see; those of the orbit above see 200 and more
    posed = [image for image in model.images.values() if image.has_pose]
    if not posed:
        return
    positions = np.array([image.projection_center() for image in posed])
    away = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    for image, flown in zip(posed, away > _MAX_DISTANCE * np.median(away), strict=True):
        if flown or image.num_points3D < least_points:
            model.deregister_frame(image.frame_id)


def disagreeing_photos(model: pycolmap.Reconstruction, path: Path) -> set[int]:
    """Return the ids of images in pairs whose verified matches, in the database, contradict the poses."""
    # COLMAP's error of a match; right pairs have at least 0.97 of such matches, wrong ones 0 to 0.94
    min_matches, max_error_px, min_share = 100, 4.0, 0.95
    wrong: set[int] = set()
    with pycolmap.Database.open(path) as database:
        geometries = zip(*database.read_two_view_geometries(), strict=True)
        keypoints = {one: database.read_keypoints(one)[:, :2].astype(np.float64) for one in model.reg_image_ids()}
    for number, geometry in geometries:
        matches, ids = geometry.inlier_matches, pycolmap.pair_id_to_image_pair(number)
        if len(matches) < min_matches or not keypoints.keys() >= set(ids):
            continue
        pair = [model.images[one] for one in ids]
        places = [
            model.cameras[image.camera_id].cam_from_img(keypoints[image.image_id][rows])
            for image, rows in zip(pair, matches.T, strict=True)
        ]
        essential = pycolmap.essential_matrix_from_pose(pair[1].cam_from_world() * pair[0].cam_from_world().inverse())
        error_px = np.sqrt(pycolmap.compute_squared_sampson_error(places[0], places[1], essential))
        error_px *= model.cameras[pair[0].camera_id].mean_focal_length()
        if (error_px < max_error_px).mean() < min_share:
            wrong.update(ids)
    return wrong


def _map_once(search: _Search, attempt: int, min_inliers: int, min_ratio: float) -> pycolmap.Reconstruction | None:
    number = len(search.photos)
    options = pycolmap.IncrementalPipelineOptions()
    options.mapper.abs_pose_min_num_inliers, options.mapper.abs_pose_min_inlier_ratio = min_inliers, min_ratio
    options.num_threads, options.random_seed, options.mapper.random_seed = search.threads, _SEED, _SEED
    options.min_model_size = 3
    options.multiple_models = True
    registered = [2]

    def count() -> None:
        registered[0] += 1
        search.tell("cameras", attempt * number + min(registered[0], number), 2 * number)

    sparse, begun = search.folder / "sparse", search.folder / "begun"
    for folder in (sparse, begun):
        folder.mkdir(exist_ok=True)

    def mapped(start: str = "") -> pycolmap.Reconstruction | None:
        models = pycolmap.incremental_mapping(
            search.database, search.images, sparse, options, start, next_image_callback=count
        )
        for model in models.values():
            leave_out_unreliable(model)
        return max(models.values(), key=pycolmap.Reconstruction.num_reg_images, default=None)

    first = mapped()
    if first is None or not (wrong := disagreeing_photos(first, search.database)):
        return first
    rest = pycolmap.Reconstruction(first)
    for number in wrong:
        rest.deregister_frame(rest.images[number].frame_id)
    rest.write(begun)
    second = mapped(str(begun))
    return second if second and len(disagreeing_photos(second, search.database)) < len(wrong) else first


def _write_model(search: _Search, model: pycolmap.Reconstruction, masked: list[str]) -> None:
    search.tell("undistort", 0, 1)
    folder, threads = search.folder, search.threads
    place = {photo.name: row for row, photo in enumerate(search.photos)}
    chosen, undistorted = folder / "chosen", folder / "undistorted"
    chosen.mkdir(exist_ok=True)
    for camera in model.cameras.values():
        replace_weak_lens(camera)
    model.write(chosen)
    pycolmap.undistort_images(undistorted, chosen, folder / "photos", num_threads=threads, jpeg_quality=95)
    if masked:
        masks = folder / "masks"
        masks.mkdir(exist_ok=True)
        for name in masked:  # copies with the photos' names, which COLMAP undistorts like the photos
            shutil.copyfile(folder / "photos" / f"{name}.png", masks / name)
        bent = folder / "undistorted-masks"
        pycolmap.undistort_images(bent, chosen, masks, masked, num_threads=threads, jpeg_quality=95)
    pinholes = pycolmap.Reconstruction(undistorted / "sparse")
    point_row = {point_id: row for row, point_id in enumerate(pinholes.points3D)}
    views: list[dict[str, object]] = []
    seen: list[tuple[int, int]] = []
    finder, sightings = MarkerFinder(), []
    for image in sorted(pinholes.images.values(), key=lambda image: place[image.name]):
        if not image.has_pose:
            continue
        camera = pinholes.cameras[image.camera_id]
        pose = image.cam_from_world()
        seen += [(len(views), point_row[point.point3D_id]) for point in image.get_observation_points2D()]
        with Image.open(undistorted / "images" / image.name) as picture:
            sightings.append(Sighting(camera, pose, finder.find(np.array(picture.convert("L")))))
        views.append(
            {
                "name": image.name,
                "rotation": pose.rotation.matrix().tolist(),
                "translation": pose.translation.tolist(),
                "width": camera.width,
                "height": camera.height,
                "focal_px": [camera.focal_length_x, camera.focal_length_y],
                "principal_px": [camera.principal_point_x, camera.principal_point_y],
            }
        )
    points = list(pinholes.points3D.values())
    np.savez(
        folder / "points.npz",
        positions=np.array([point.xyz for point in points]).reshape(-1, 3),
        colors=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
        seen=np.array(seen, np.int64).reshape(-1, 2),
    )
    error_px = model.compute_mean_reprojection_error()
    being_written = folder / "views.part"
    with pycolmap.Database.open(search.database) as database:
        left_out = failure_reasons(database, {str(view["name"]) for view in views})
    markers = [asdict(marker) for marker in placed_markers(sightings)]
    document = {"reprojection_error_px": error_px, "views": views, "left_out": left_out, "markers": markers}
    being_written.write_text(json.dumps(document))
    being_written.replace(folder / "views.json")
    search.tell("undistort", 1, 1)


def replace_weak_lens(camera: pycolmap.Camera) -> None:
    """Replace a lens whose distortion is below a tenth of a pixel everywhere with a pinhole, in place.

    COLMAP copies photos of a pinhole camera; it resamples all others, a pixel smaller and shifted by half a pixel.
    """
    least_px = 0.1
    edges = np.stack(np.meshgrid([0, camera.width / 2, camera.width], [0, camera.height / 2, camera.height]), -1)
    places = edges.reshape(-1, 2).astype(np.float64)
    focal_px = np.array([camera.focal_length_x, camera.focal_length_y])
    middle_px = np.array([camera.principal_point_x, camera.principal_point_y])
    if np.abs(camera.cam_from_img(places) * focal_px + middle_px - places).max() < least_px:
        camera.model, camera.params = pycolmap.CameraModelId.PINHOLE, [*focal_px, *middle_px]


def _end_with_parent() -> None:
    """Ask the kernel (Linux) to kill this process when its parent dies; a killed parent cannot."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG of linux/prctl.h


def failure_reasons(database: pycolmap.Database, placed: Container[str]) -> dict[str, str]:
    """Explain, for each photo that is not `placed`, why it has no camera; by its name in the database."""
    images = database.read_all_images()
    others = [image.image_id for image in images if image.name in placed]
    pairs = dict(zip(*database.read_two_view_geometry_num_inliers(), strict=True))
    sentences = {}
    for image in images:
        if image.name in placed:
            continue
        numbers = (pairs.get(pycolmap.image_pair_to_pair_id(image.image_id, other), 0) for other in others)
        sentences[image.name] = _reason(database.num_keypoints_for_image(image.image_id), max(numbers, default=0))
    return sentences


def _reason(num_features: int, num_shared: int) -> str:
    few_features, few_shared = 200, 30  # COLMAP registers a photo by at least 30 points that it shares with others
    if num_features < few_features:
        return f"it has {num_features} features; {few_features} are few: it is blurred, dark or plain"
    if num_shared < few_shared:
        return (
            f"it shares {num_shared} points with the photo most like it; {few_shared} are needed: "
            "it was taken from too far aside, or shows something else"
        )
    return (
        f"it shares {num_shared} points with another photo and fits at no place: something moved, looks "
        "alike twice, or only what is far away is seen in both"
    )


if __name__ == "__main__":
    _end_with_parent()
    if not pycolmap.has_cuda:  # CUDA reserves more address space than any limit allows
        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, MAX_MEMORY_BYTES))
    job = json.load(sys.stdin)
    cameras = None if job["given"] is None else [InputCamera.from_json(fields) for fields in job["given"]]
    map_photos(Path(job["folder"]), [Photo(**fields) for fields in job["photos"]], cameras)
