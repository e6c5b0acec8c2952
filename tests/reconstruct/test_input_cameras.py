"""Cameras that come with the photos, in every format, are the cameras that took them."""

import json
import os
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from dynamictree.errors import FormatError
from dynamictree.reconstruct.input_cameras import InputCamera, find_input_cameras
from dynamictree.render.camera import Camera
from tests.reconstruct.conftest import HEIGHT, WIDTH, Orbit

FOCAL = 0.5 / np.tan(np.radians(38) / 2) * HEIGHT


def names_of(orbit: Orbit) -> list[str]:
    return [f"images/{path.name}" for path in orbit.photos]


def sizes_of(orbit: Orbit) -> dict[str, tuple[tuple[int, int], tuple[int, int]]]:
    return dict.fromkeys(names_of(orbit), ((WIDTH, HEIGHT), (WIDTH, HEIGHT)))


def to_world(camera: Camera) -> np.ndarray:
    """Camera to world in OpenCV's axes."""
    return np.concatenate([camera.world_to_camera.T, camera.position_m[:, None]], axis=1)


def write_transforms(folder: Path, orbit: Orbit, *, blender: bool = False, **changed: object) -> Path:
    frames = []
    for name, camera in zip(names_of(orbit), orbit.cameras, strict=True):
        matrix = np.eye(4)
        matrix[:3] = to_world(camera) * [1, -1, -1, 1]
        path_in_file = f"./{name.removesuffix('.jpg')}" if blender else name
        frames.append({"file_path": path_in_file, "transform_matrix": matrix.tolist()})
    lens = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT}
    if blender:
        lens = {"camera_angle_x": 2 * np.arctan(0.5 * WIDTH / FOCAL)}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "transforms.json"
    path.write_text(json.dumps({**lens, "frames": frames, **changed}))
    return path


def write_colmap(folder: Path, orbit: Orbit, suffix: str) -> None:
    """As COLMAP has it; the images see points, one more each."""
    model, lens = pycolmap.Reconstruction(), (FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
    camera = pycolmap.Camera(camera_id=7, model="PINHOLE", width=WIDTH, height=HEIGHT, params=lens)
    model.add_camera_with_trivial_rig(camera)
    for number, (path, true) in enumerate(zip(orbit.photos, orbit.cameras, strict=True)):
        image = pycolmap.Image(name=path.name, keypoints=np.ones((number, 2)), camera_id=7, image_id=number + 1)
        pose = np.column_stack([true.world_to_camera, -true.world_to_camera @ true.position_m])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    folder.mkdir(parents=True)
    (model.write_text if suffix == "txt" else model.write_binary)(folder)


def write_llff(folder: Path, orbit: Orbit) -> None:
    folder.mkdir(parents=True)
    rows = []
    for camera in orbit.cameras:
        right, down, forward = camera.world_to_camera
        pose = np.stack([down, right, -forward, camera.position_m, [HEIGHT, WIDTH, FOCAL]], axis=1)
        rows.append([*pose.ravel(), 1.0, 10.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))


WRITERS = {
    "nerfstudio": write_transforms,
    "blender": lambda root, orbit: write_transforms(root, orbit, blender=True),
    "colmap text": lambda root, orbit: write_colmap(root / "sparse" / "0", orbit, "txt"),
    "colmap binary": lambda root, orbit: write_colmap(root / "sparse" / "0", orbit, "bin"),
    "llff": lambda root, orbit: write_llff(root / "llff", orbit),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_cameras_back(tmp_path, orbit, name):
    WRITERS[name](tmp_path, orbit)
    given = find_input_cameras(tmp_path, sizes_of(orbit))
    assert [camera.photo for camera in given] == names_of(orbit)
    for camera, true in zip(given, orbit.cameras, strict=True):
        assert np.allclose(camera.world_to_camera[:, :3], true.world_to_camera, atol=1e-6)
        assert np.allclose(-camera.world_to_camera[:, :3].T @ camera.world_to_camera[:, 3], true.position_m, atol=1e-6)
        assert camera.params[0] == pytest.approx(FOCAL)
        assert (camera.width, camera.height) == (WIDTH, HEIGHT)
        assert (WIDTH / 2, HEIGHT / 2) in (camera.params[-2:], camera.params[1:3])


def test_a_downloaded_llff_folder_of_reduced_photos_takes_the_poses_in_order(tmp_path, orbit):
    write_colmap(tmp_path / "sparse" / "0", orbit, "bin")
    write_llff(tmp_path / "llff", orbit)
    sizes = dict(zip((f"images_4/image{n:03}.png" for n in range(99)), sizes_of(orbit).values(), strict=False))
    given = find_input_cameras(tmp_path, sizes)
    assert [camera.photo for camera in given] == list(sizes)
    assert {camera.model for camera in find_input_cameras(tmp_path, sizes_of(orbit)) or ()} == {"PINHOLE"}  # names lead


def test_frames_without_photos_are_left_out_and_each_camera_keeps_its_lens(tmp_path, orbit):
    path = write_transforms(tmp_path, orbit)
    document = json.loads(path.read_text())
    for number, frame in enumerate(document["frames"]):
        frame["fl_x"], frame["fl_y"] = FOCAL + number, FOCAL + 2 * number
    path.write_text(json.dumps(document))
    some = dict(list(sizes_of(orbit).items())[2:9])
    given = find_input_cameras(tmp_path, some)
    assert [camera.photo for camera in given] == list(some)
    assert [camera.params[:2] for camera in given] == [(FOCAL + n, FOCAL + 2 * n) for n in range(2, 9)]


def test_bent_lenses_keep_their_numbers(tmp_path, orbit):
    write_transforms(tmp_path, orbit, k1=0.1, k2=-0.02, p1=0.001, p2=0.002)
    (first, *_) = find_input_cameras(tmp_path, sizes_of(orbit)) or ()
    assert (first.model, first.params[4:]) == ("OPENCV", (0.1, -0.02, 0.001, 0.002))
    write_transforms(tmp_path, orbit, camera_model="OPENCV_FISHEYE", k1=0.1, k2=-0.02, k3=0.003)
    (first, *_) = find_input_cameras(tmp_path, sizes_of(orbit)) or ()
    assert (first.model, first.params[4:]) == ("OPENCV_FISHEYE", (0.1, -0.02, 0.003, 0.0))


def test_a_scale_in_the_rotation_is_taken_out(tmp_path, orbit):
    path = write_transforms(tmp_path, orbit)
    document = json.loads(path.read_text())
    for frame in document["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, :3] *= 2.5
        frame["transform_matrix"] = matrix.tolist()
    path.write_text(json.dumps(document))
    first: InputCamera = (find_input_cameras(tmp_path, sizes_of(orbit)) or ())[0]
    assert np.allclose(first.world_to_camera[:, :3], orbit.cameras[0].world_to_camera, atol=1e-6)


def broken_colmap(root: Path, orbit: Orbit, cut: int) -> None:
    write_colmap(root / "sparse", orbit, "bin")
    path = root / "sparse" / "images.bin"
    path.write_bytes(path.read_bytes()[:cut])


def lens_of_unknown_model(root: Path, orbit: Orbit) -> None:
    write_colmap(root / "sparse", orbit, "txt")
    path = root / "sparse" / "cameras.txt"
    path.write_text(path.read_text().replace("PINHOLE", "PERISCOPE"))


def only_cameras(root: Path, orbit: Orbit) -> None:
    write_colmap(root / "sparse", orbit, "txt")
    (root / "sparse" / "images.txt").unlink()


def poses_of_shape(root: Path, shape: tuple[int, ...], fill: float = 1.0) -> None:
    np.save(root / "poses_bounds.npy", np.full(shape, fill))


def same_frames(root: Path, orbit: Orbit, names: list[str], **changed: object) -> None:
    frames = [{"file_path": name, "transform_matrix": np.eye(4).tolist()} for name in names]
    write_transforms(root, orbit, frames=frames, **changed)


BROKEN = {
    "no json": (lambda root, orbit: (root / "transforms.json").write_text("{"), "transforms.json cannot be read"),
    "no frames": (lambda root, orbit: (root / "transforms.json").write_text("{}"), "transforms.json cannot be read"),
    "list": (lambda root, orbit: (root / "transforms.json").write_text("[1]"), "transforms.json cannot be read"),
    "empty": (lambda root, orbit: write_transforms(root, orbit, frames=[]), "names 'nothing' and no photo"),
    "other photos": (lambda root, orbit: same_frames(root, orbit, ["elsewhere.jpg"]), "and no photo that is there"),
    "twice": (lambda root, orbit: same_frames(root, orbit, 2 * names_of(orbit)), "names a photo twice"),
    "one place": (lambda root, orbit: same_frames(root, orbit, names_of(orbit)), "at one place"),
    "no angle": (
        lambda root, orbit: same_frames(root, orbit, names_of(orbit), fl_x=None, camera_angle_x=0),
        "cannot be read",
    ),
    "large": (lambda root, orbit: os.truncate(write_transforms(root, orbit), 2**30), "1,073,741,824 bytes; at most"),
    "other size": (lambda root, orbit: write_transforms(root, orbit, w=300), "300 x 300 pixels, it has 400 x 300"),
    "no focal": (lambda root, orbit: write_transforms(root, orbit, fl_x=0.0), "focal length 0; it must be positive"),
    "not a number": (lambda root, orbit: write_transforms(root, orbit, fl_x=float("nan")), "no rotation and place"),
    "truncated": (lambda root, orbit: broken_colmap(root, orbit, 500), "COLMAP model cannot be read"),
    "cut name": (lambda root, orbit: broken_colmap(root, orbit, 75), "COLMAP model cannot be read"),
    "model": (lens_of_unknown_model, "PERISCOPE"),
    "half": (only_cameras, "cameras.txt is there and images.txt is not"),
    "rows": (lambda root, orbit: poses_of_shape(root, (3, 17)), "has 3 rows and there are 14 photos"),
    "shape": (lambda root, orbit: poses_of_shape(root, (14, 15)), r"shape \(14, 15\); \(14, 17\) is needed"),
    "size": (lambda root, orbit: poses_of_shape(root, (14, 17), 0.5), "0.5 x 0.5 pixels; give its size"),
    "nan": (lambda root, orbit: poses_of_shape(root, (14, 17), np.nan), "nan x nan pixels"),
    "no npy": (lambda root, orbit: (root / "poses_bounds.npy").write_bytes(b"x" * 99), "cannot be read"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_refuses_what_is_no_set_of_cameras(tmp_path, orbit, name):
    write, message = BROKEN[name]
    write(tmp_path, orbit)
    with pytest.raises(FormatError, match=message):
        find_input_cameras(tmp_path, sizes_of(orbit))
