"""Registered photos, each with an undistorted picture and a camera, and their shared points."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt8
from PIL import Image

from dynamictree.reconstruct.markers import Marker
from dynamictree.reconstruct.photo_cameras import PhotoCamera
from dynamictree.render.camera import Camera


@dataclass(frozen=True, kw_only=True)
class View:
    """Registered photo."""

    source: str  # the photo's name as given
    image: UInt8[np.ndarray, "H W 3"]  # undistorted
    camera: Camera
    alpha: UInt8[np.ndarray, "H W"] | None = None  # mask of the subject, 255 inside; None without masks

    @property
    def photo_camera(self) -> PhotoCamera:
        """Camera with the photo's name and size."""
        height, width = self.image.shape[:2]
        return PhotoCamera(photo=self.source, camera=self.camera, width=width, height=height)

    def pixels_of(
        self, points: Float[np.ndarray, "P 3"]
    ) -> tuple[tuple[Int64[np.ndarray, " P"], Int64[np.ndarray, " P"]], Bool[np.ndarray, " P"]]:
        """Project points to row and column, and test whether they are in the picture; 0 for those outside."""
        height, width = self.image.shape[:2]
        x, y, depth = self.camera.project(points, width, height).T
        inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        return (np.where(inside, y, 0).astype(np.int64), np.where(inside, x, 0).astype(np.int64)), inside


def resized(
    plane: Float32[np.ndarray, "H W"], size: tuple[int, int], how: Image.Resampling = Image.Resampling.BOX
) -> Float32[np.ndarray, "h w"]:
    """Resize a picture of one channel to another width and height."""
    return np.array(Image.fromarray(np.ascontiguousarray(plane)).resize(size, how), np.float32)


def nearest_pixels(picture: Float32[np.ndarray, "H W *C"], height: int, width: int) -> Float32[np.ndarray, "h w *C"]:
    """Resize a picture by nearest-neighbour sampling."""
    rows, columns = (np.arange(new) * old // new for new, old in zip((height, width), picture.shape, strict=False))
    return np.ascontiguousarray(picture[np.ix_(rows, columns)])


@dataclass(frozen=True, kw_only=True)
class SparseModel:
    """Result of structure from motion: views and points, in an arbitrary frame and unit."""

    views: tuple[View, ...]
    points: Float64[np.ndarray, "P 3"]
    colors: UInt8[np.ndarray, "P 3"]
    seen: Int64[np.ndarray, "M 2"]  # pairs of a view's and a point's row
    reprojection_error_px: float
    left_out: Mapping[str, str] = field(default_factory=dict)  # reason by the photo's original name
    markers: tuple[Marker, ...] = ()  # most photos first

    def transformed(
        self, scale: float, rotation: Float64[np.ndarray, "3 3"], origin: Float64[np.ndarray, "3"]
    ) -> "SparseModel":
        """Transform to the frame x' = scale · rotation · (x − origin)."""
        views = tuple(
            replace(
                view,
                camera=replace(
                    view.camera,
                    position_m=scale * rotation @ (view.camera.position_m - origin),
                    world_to_camera=view.camera.world_to_camera @ rotation.T,
                ),
            )
            for view in self.views
        )
        markers = tuple(replace(marker, edge=scale * marker.edge) for marker in self.markers)
        return replace(self, views=views, points=scale * (self.points - origin) @ rotation.T, markers=markers)


def _pixels(path: Path, mode: str, size: tuple[int, int]) -> UInt8[np.ndarray, "..."] | None:
    if not path.exists():
        return None
    with Image.open(path) as image:
        converted = image.convert(mode)
    return np.array(converted if converted.size == size else converted.resize(size, Image.Resampling.LANCZOS))


def read_model(folder: Path, sources: dict[str, str]) -> SparseModel | None:
    """Read the files of `mapping`; None if no photos could be registered. `sources` has the photos' original names.

    Photos with non-square pixels (two focal lengths) are stretched, since a `Camera` has one focal length.
    """
    if not (folder / "views.json").exists():
        return None
    document = json.loads((folder / "views.json").read_text())
    with np.load(folder / "points.npz", allow_pickle=False) as arrays:
        positions, colors, seen = arrays["positions"], arrays["colors"], arrays["seen"]
    views = []
    for view in document["views"]:
        rotation = np.array(view["rotation"])
        focal_x, focal_y = view["focal_px"]
        width, height = view["width"], round(view["height"] * focal_x / focal_y)
        camera = Camera(
            position_m=-rotation.T @ np.array(view["translation"]),
            world_to_camera=rotation,
            focal=focal_y / view["height"],
            centre=(view["principal_px"][0] / width, view["principal_px"][1] / view["height"]),
        )
        image = _pixels(folder / "undistorted" / "images" / view["name"], "RGB", (width, height))
        assert image is not None
        alpha = _pixels(folder / "undistorted-masks" / "images" / view["name"], "L", (width, height))
        views.append(View(source=sources[view["name"]], image=image, camera=camera, alpha=alpha))
    return SparseModel(
        views=tuple(views),
        points=positions,
        colors=colors,
        seen=seen,
        reprojection_error_px=float(document["reprojection_error_px"]),
        left_out={sources[name]: reason for name, reason in document["left_out"].items()},
        markers=tuple(Marker(**marker) for marker in document["markers"]),
    )
