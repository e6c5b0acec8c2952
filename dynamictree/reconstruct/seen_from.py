"""Cameras of a finished reconstruction, read from `cameras.json`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from jaxtyping import Float64

from dynamictree.errors import InputError
from dynamictree.reconstruct.stage import nearest_to_axes
from dynamictree.render.camera import Camera


@dataclass(frozen=True, kw_only=True)
class SeenFrom:
    """Camera of one photo, and the size of its picture [px]."""

    photo: str
    camera: Camera
    width: int
    height: int

    def reduced(self, side_px: int) -> "SeenFrom":
        """The same with a smaller picture; its shape may change by half a pixel."""
        shrink = min(1.0, side_px / max(self.width, self.height))
        width, height = max(1, round(shrink * self.width)), max(1, round(shrink * self.height))
        return SeenFrom(photo=self.photo, camera=self.camera, width=width, height=height)


def read_cameras(document: Mapping[str, Any]) -> list[SeenFrom]:
    """Cameras as `report.write_cameras` writes them."""
    return [_camera(fields) for fields in document["cameras"]]


def _camera(fields: Mapping[str, Any]) -> SeenFrom:
    width, height = fields["width"], fields["height"]
    camera = Camera(
        position_m=np.array(fields["position_m"], np.float64),
        world_to_camera=np.array(fields["world_to_camera"], np.float64),
        focal=fields["focal_px"] / height,
        centre=(fields["principal_px"][0] / width, fields["principal_px"][1] / height),
    )
    return SeenFrom(photo=fields["photo"], camera=camera, width=width, height=height)


def view_of_photo(views: list[SeenFrom], name: str) -> SeenFrom:
    """The camera of a photo by its name, without folders if no other has the same.

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


def focus_of(views: list[SeenFrom]) -> tuple[Float64[np.ndarray, "3"], float]:
    """The point nearest to all viewing axes, and the cameras' median distance from it [m]."""
    positions = np.array([view.camera.position_m for view in views])
    forward = np.array([view.camera.world_to_camera[2] for view in views])
    focus = nearest_to_axes(positions, forward)
    return focus, float(np.median(np.linalg.norm(positions - focus, axis=1)))
