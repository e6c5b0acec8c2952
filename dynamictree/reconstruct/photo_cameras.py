"""Cameras of a finished reconstruction, stored in `cameras.json`."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float64

from dynamictree.errors import InputError
from dynamictree.render.camera import Camera

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True)
class PhotoCamera:
    """Camera of one photo, and the size of its picture [px]."""

    photo: str
    camera: Camera
    width: int
    height: int

    def reduced(self, side_px: int) -> "PhotoCamera":
        """Return the camera for a smaller picture; its aspect ratio may change by half a pixel."""
        shrink = min(1.0, side_px / max(self.width, self.height))
        width, height = max(1, round(shrink * self.width)), max(1, round(shrink * self.height))
        return PhotoCamera(photo=self.photo, camera=self.camera, width=width, height=height)


def write_cameras(cameras: Sequence[PhotoCamera], folder: Path, *, scale: str) -> None:
    """Write `cameras.json`: intrinsics and pose of each registered photo."""
    document = {
        "axes": "camera x right, y down, z forward; world +Z up; pixel centres at half-integers",
        "scale": scale,
        "cameras": [_fields(camera) for camera in cameras],
    }
    (folder / "cameras.json").write_text(json.dumps(document, indent=1))


def read_cameras(document: Mapping[str, Any]) -> list[PhotoCamera]:
    """Read the cameras of a document that `write_cameras` wrote."""
    return [_camera(fields) for fields in document["cameras"]]


def _fields(photo: PhotoCamera) -> dict[str, object]:
    matrix = photo.camera.intrinsics_px(photo.width, photo.height)
    return {
        "photo": photo.photo,
        "width": photo.width,
        "height": photo.height,
        "focal_px": matrix[0, 0],
        "principal_px": matrix[:2, 2].tolist(),
        "position_m": photo.camera.position_m.tolist(),
        "world_to_camera": photo.camera.world_to_camera.tolist(),
    }


def _camera(fields: Mapping[str, Any]) -> PhotoCamera:
    width, height = fields["width"], fields["height"]
    camera = Camera(
        position_m=np.array(fields["position_m"], np.float64),
        world_to_camera=np.array(fields["world_to_camera"], np.float64),
        focal=fields["focal_px"] / height,
        centre=(fields["principal_px"][0] / width, fields["principal_px"][1] / height),
    )
    return PhotoCamera(photo=fields["photo"], camera=camera, width=width, height=height)


def camera_of_photo(views: list[PhotoCamera], name: str) -> PhotoCamera:
    """Find the camera of a photo by its name, which may omit folders if it is unique.

    Raises:
        InputError: there is no such photo, or there are several.
    """
    matching = [view for view in views if view.photo == name]
    matching = matching or [view for view in views if PurePosixPath(view.photo).name == PurePosixPath(name).name]
    if len(matching) != 1:
        names = ", ".join(view.photo for view in (matching or views)[:5])
        what = "means several photos" if matching else "is no photo that has a camera"
        raise InputError(f"{name!r} {what}; cameras.json names {names}{' …' if len(matching or views) > 5 else ''}")
    return matching[0]


def evenly_chosen(items: Sequence[Item], most: int) -> list[Item]:
    """Choose at most so many items, evenly in their order."""
    return [items[row] for row in np.linspace(0, len(items) - 1, min(len(items), most)).round().astype(int)]


def focus_of(views: list[PhotoCamera]) -> tuple[Float64[np.ndarray, "3"], float]:
    """Return the point nearest to all viewing axes, and the cameras' median distance from it [m]."""
    positions = np.array([view.camera.position_m for view in views])
    focus = nearest_to_axes([view.camera for view in views])
    return focus, float(np.median(np.linalg.norm(positions - focus, axis=1)))


def nearest_to_axes(cameras: Iterable[Camera]) -> Float64[np.ndarray, "3"]:
    """Find the point with the smallest sum of squared distances to all viewing axes."""
    positions, forward = np.array([(camera.position_m, camera.world_to_camera[2]) for camera in cameras]).swapaxes(0, 1)
    projectors = np.eye(3) - forward[:, :, None] * forward[:, None, :]  # [V, 3, 3]
    wanted = np.einsum("vij,vj->i", projectors, positions)
    return np.asarray(np.linalg.lstsq(projectors.sum(axis=0), wanted, rcond=None)[0])
