"""Read cameras given with the photos: nerfstudio's or Blender's `transforms.json`, a COLMAP model, LLFF's poses.

Formats: nerfstudio docs/quickstart/data_conventions.md; COLMAP doc/format.rst; LLFF (Mildenhall et al. 2019), README.
"""

import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float64

from dynamictree.errors import FormatError
from dynamictree.rotation import quaternion_matrices

TRANSFORMS, LLFF = "transforms.json", "poses_bounds.npy"
COLMAP = ("cameras.bin", "images.bin"), ("cameras.txt", "images.txt")
MAX_BYTES = 512 * 2**20
_MODELS = {  # COLMAP's number, name, number of parameters
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
}
_LENGTHS = dict(_MODELS.values())
_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")

Size = tuple[int, int]
Sizes = dict[str, tuple[Size, Size]]


@dataclass(frozen=True, kw_only=True)
class InputCamera:
    """Camera of one photo, in COLMAP's conventions."""

    photo: str  # path in the cameras' file
    model: str  # name of a COLMAP camera model
    params: tuple[float, ...]  # [px] at `width` and `height`
    width: int
    height: int
    world_to_camera: Float64[np.ndarray, "3 4"]  # camera x right, y down, z forward

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON, for another process."""
        return vars(self) | {"world_to_camera": self.world_to_camera.tolist()}

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> "InputCamera":
        """Undo `to_json`."""
        matrix = np.array(fields["world_to_camera"], np.float64)
        return cls(**fields | {"params": tuple(fields["params"]), "world_to_camera": matrix})

    def scaled(self, photo: str, width: int, height: int) -> "InputCamera":
        """Return the camera of a copy of the photo that has another name and size."""
        across, down = width / self.width, height / self.height
        lengths = [across] if self.model in _ONE_FOCAL else [across, down]
        params = [value * by for value, by in zip(self.params, [*lengths, across, down], strict=False)]
        params += self.params[len(params) :]
        return replace(self, photo=photo, params=tuple(params), width=width, height=height)


def files_with_cameras(root: Path) -> list[Path]:
    """List the files in a folder and its subfolders that `find_input_cameras` may read."""
    names = {TRANSFORMS, LLFF, *(name for pair in COLMAP for name in pair)}
    return sorted(path for path in root.rglob("*") if path.name in names)


def find_input_cameras(root: Path, sizes: Sizes) -> tuple[InputCamera, ...] | None:
    """Read the cameras in a folder of photos or its subfolders; None if there are none.

    Args:
        root: unpacked input.
        sizes: width and height of the photos as stored and as EXIF rotates them, by path below the root; LLFF's
            poses refer to the photos by this order.

    Raises:
        FormatError: a file cannot be read, or names none of the photos.
    """
    max_json_bytes = 16 * 2**20  # 50 kB for each of 300 photos; a byte of JSON takes up to 30 in memory
    for path in sorted(root.rglob(TRANSFORMS)):
        return _matched(_transforms(_read(path, max_json_bytes), sizes), sizes, path.name)
    by_order = sorted(root.rglob(LLFF))
    for names in COLMAP:
        for path in sorted(root.rglob(names[0])):
            beside = path.with_name(names[1])
            if not beside.is_file():
                raise FormatError(f"{path.name} is there and {beside.name} is not; give both")
            cameras = _colmap(_read(path), _read(beside), names[0].endswith("bin"))
            if by_order and not any(_photo_named(camera.photo, sizes) for camera in cameras):
                continue  # LLFF's reduced photos have other names, in the same order
            return _matched(cameras, sizes, path.name)
    for path in by_order:
        return _llff(_read(path, max_json_bytes), sizes)
    return None


def _read(path: Path, most: int = MAX_BYTES) -> bytes:
    size = path.stat().st_size
    if size > most:
        raise FormatError(f"{path.name} has {size:,} bytes; at most {most:,} are allowed; leave out all but cameras")
    return path.read_bytes()


def _matched(cameras: list[InputCamera], sizes: Sizes, source: str) -> tuple[InputCamera, ...]:
    """Return the cameras whose photo exists, each with that photo's name; check them."""
    matched = []
    for camera in cameras:
        name = _photo_named(camera.photo, sizes)
        if name is not None:
            matched.append(replace(camera, photo=name))
    if len({camera.photo for camera in matched}) < len(matched):
        raise FormatError(f"{source} names a photo twice; give each one camera")
    if not matched:
        first = cameras[0].photo if cameras else "nothing"
        raise FormatError(f"{source} names {first!r} and no photo that is there; give the photos that it names")
    for camera in matched:
        _check(camera, sizes[camera.photo], source)
    places = np.stack([-camera.world_to_camera[:, :3].T @ camera.world_to_camera[:, 3] for camera in matched])
    if len(matched) > 1 and not np.ptp(places, axis=0).max() > 0:
        raise FormatError(f"{source} puts all cameras at one place, from which no depth is seen; export it again")
    return tuple(matched)


def _photo_named(wanted: str, sizes: Sizes) -> str | None:
    """Find the photo whose path ends like the wanted one; the suffix may be missing, as in Blender's files."""
    parts = [part for part in PurePosixPath(wanted.replace("\\", "/")).parts if part not in (".", "..", "/")]
    for skipped in range(len(parts)):
        tail = "/".join(parts[skipped:])
        for name in sizes:
            if f"/{name}".endswith(f"/{tail}") or f"/{PurePosixPath(name).with_suffix('')}".endswith(f"/{tail}"):
                return name
    return None


def _check(camera: InputCamera, sizes: tuple[Size, Size], source: str) -> None:
    rotation = camera.world_to_camera[:, :3]
    finite = np.isfinite(camera.world_to_camera).all() and np.isfinite(camera.params).all()
    if not finite or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise FormatError(f"the camera of {camera.photo} in {source} is no rotation and place; export it again")
    if not camera.params[0] > 0:
        raise FormatError(
            f"the camera of {camera.photo} has the focal length {camera.params[0]:g}; it must be positive"
        )
    if not any(fits(camera, size) for size in sizes):
        problem = f"{source} says that {camera.photo} has {camera.width} x {camera.height} pixels, it has"
        raise FormatError(f"{problem} {sizes[0][0]} x {sizes[0][1]}; give the photos that the cameras were found with")


def fits(camera: InputCamera, size: Size) -> bool:
    """Whether a picture's aspect ratio is the camera's; the picture may be a smaller copy."""
    return abs(camera.width * size[1] - camera.height * size[0]) <= 0.01 * camera.width * size[1]


def _transforms(content: bytes, sizes: Sizes) -> list[InputCamera]:
    try:
        document = json.loads(content)
        frames = [{**{k: v for k, v in document.items() if k != "frames"}, **frame} for frame in document["frames"]]
        return [_from_frame(frame, sizes) for frame in frames]
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError) as error:
        raise FormatError(f"{TRANSFORMS} cannot be read: {error!r}; see nerfstudio's data conventions") from error


def _from_frame(frame: dict[str, Any], sizes: Sizes) -> InputCamera:
    name = str(frame["file_path"])
    photo = _photo_named(name, sizes)
    width, height = sizes[photo][1] if photo is not None else (1, 1)
    width, height = int(frame.get("w", width)), int(frame.get("h", height))
    focal = float(frame["fl_x"]) if "fl_x" in frame else 0.5 * width / math.tan(float(frame["camera_angle_x"]) / 2)
    centre = float(frame.get("cx", width / 2)), float(frame.get("cy", height / 2))
    bends = tuple(float(frame.get(key, 0)) for key in ("k1", "k2", "p1", "p2"))
    params = (focal, float(frame.get("fl_y", focal)), *centre)
    model = "OPENCV" if any(bends) else "PINHOLE"
    if str(frame.get("camera_model", "")).upper() == "OPENCV_FISHEYE":
        model, bends = "OPENCV_FISHEYE", tuple(float(frame.get(f"k{n}", 0)) for n in range(1, 5))
    to_world = np.array(frame["transform_matrix"], np.float64).reshape(4, 4)
    return InputCamera(
        photo=name,
        model=model,
        params=params if model == "PINHOLE" else (*params, *bends),
        width=width,
        height=height,
        world_to_camera=_inverted(to_world[:3, :3] * [1, -1, -1], to_world[:3, 3]),  # OpenGL's axes: y up, z back
    )


def _llff(content: bytes, sizes: Sizes) -> tuple[InputCamera, ...]:
    try:
        rows = np.load(BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise FormatError(f"{LLFF} cannot be read: {error}; write it with numpy.save") from error
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        raise FormatError(f"{LLFF} has the shape {rows.shape}; ({len(sizes)}, 17) is needed: a row a photo")
    if len(rows) != len(sizes):
        raise FormatError(
            f"{LLFF} has {len(rows)} rows and there are {len(sizes)} photos; give a photo per row, in order"
        )
    cameras = []
    for row, (name, either) in zip(rows.astype(np.float64), sizes.items(), strict=True):
        pose = row[:15].reshape(3, 5)
        height, width, focal = pose[:, 4]
        down, right, back, position = pose[:, :4].T
        if not (height >= 1 and width >= 1):
            raise FormatError(f"{LLFF} says that {name} has {width:g} x {height:g} pixels; give its size")
        camera = InputCamera(
            photo=name,
            model="SIMPLE_RADIAL",  # the file lacks the lens's distortion, which refinement may estimate
            params=(float(focal), float(width) / 2, float(height) / 2, 0.0),
            width=int(width),
            height=int(height),
            world_to_camera=_inverted(np.stack([right, down, -back], axis=1), position),
        )
        _check(camera, either, LLFF)
        cameras.append(camera)
    return tuple(cameras)


def _inverted(rotation: Float64[np.ndarray, "3 3"], position: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 4"]:
    """Invert a camera-to-world transform; a scale in its rotation, which some exporters leave, is removed."""
    size = np.cbrt(max(abs(np.linalg.det(rotation)), 1e-12))
    to_camera = rotation.T / size
    return np.concatenate([to_camera, -(to_camera @ position)[:, None]], axis=1)


def _colmap(cameras: bytes, images: bytes, binary: bool) -> list[InputCamera]:
    read: Callable[[bytes, bytes], list[InputCamera]] = _colmap_binary if binary else _colmap_text
    try:
        return read(cameras, images)
    except (struct.error, ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
        raise FormatError(f"the COLMAP model cannot be read: {error!r}; export it again") from error


def _colmap_text(cameras: bytes, images: bytes) -> list[InputCamera]:
    lenses = {}
    for line in cameras.decode().splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        number, model, width, height, *params = line.split()
        lenses[number] = (model, int(width), int(height), [float(value) for value in params])
    result = []
    # every second line lists the points that an image sees, and may be empty
    for line in [line for line in images.decode().splitlines() if not line.startswith("#")][::2]:
        if not line.strip():
            continue
        _, *pose, lens, name = line.split(maxsplit=9)
        result.append(_colmap_camera(name, lenses[lens], [float(value) for value in pose]))
    return result


def _colmap_binary(cameras: bytes, images: bytes) -> list[InputCamera]:
    lenses, at = {}, 8
    for _ in range(struct.unpack_from("<Q", cameras)[0]):
        number, model_number, width, height = struct.unpack_from("<iiQQ", cameras, at)
        model, length = _MODELS[model_number]
        lenses[number] = (model, width, height, list(struct.unpack_from(f"<{length}d", cameras, at + 24)))
        at += 24 + 8 * length
    result, at = [], 8
    for _ in range(struct.unpack_from("<Q", images)[0]):
        _, *pose, lens = struct.unpack_from("<i7di", images, at)
        end = images.index(b"\0", at + 64)
        (num_points,) = struct.unpack_from("<Q", images, end + 1)
        result.append(_colmap_camera(images[at + 64 : end].decode(), lenses[lens], pose))
        at = end + 9 + 24 * num_points
    return result


def _colmap_camera(name: str, lens: tuple[str, int, int, Sequence[float]], pose: Sequence[float]) -> InputCamera:
    model, width, height, params = lens
    if model not in _LENGTHS or len(params) != _LENGTHS[model] or min(width, height) < 1:
        raise ValueError(f"a camera of model {model} with {len(params)} numbers; {', '.join(_LENGTHS)} are allowed")
    rotation = quaternion_matrices(np.array([pose[:4]]) / np.linalg.norm(pose[:4]))[0]
    matrix = np.concatenate([rotation, np.array(pose[4:7])[:, None]], axis=1)
    return InputCamera(
        photo=name, model=model, params=tuple(params), width=width, height=height, world_to_camera=matrix
    )
