"""Quality of a reconstruction: warnings, the plant's PSNR, and a picture that compares held-out photos with it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.camera_circle import camera_circle, circle_picture
from dynamictree.reconstruct.photo_cameras import evenly_chosen
from dynamictree.reconstruct.photo_previews import read_photo_previews
from dynamictree.reconstruct.picture_loss import psnr
from dynamictree.reconstruct.result import Reconstruction
from dynamictree.render import Camera, Renderer, RenderSettings, write_png

LEAST_GAIN_DB = 3.0
"""Least gain of the splat over a picture of one colour; it halves the squared error."""
_REPORT_SIDE_PX = 640
_INSIDE = 0.5  # least alpha


def quality_warnings(psnr_db: Sequence[float], blank_psnr_db: Sequence[float]) -> list[str]:
    """Warn if the splat matches held-out photos hardly better than a picture of one colour."""
    reached, blank = float(np.mean(psnr_db)), float(np.mean(blank_psnr_db))
    if reached >= blank + LEAST_GAIN_DB:
        return []
    return [
        f"photos held out are shown with {reached:.1f} dB, a picture of one colour has {blank:.1f} dB: do not trust "
        "the splat; look at report.png, check masks and given cameras, and take more photos, sharp and in even light"
    ]


def photos_to_compare(held_out: Sequence[str]) -> list[str]:
    """Choose the held-out photos for `report.png`, evenly."""
    most_rows = 6  # number held out of 50 photos; more rows are hard to view
    return evenly_chosen(held_out, most_rows)


def write_report_picture(result: Reconstruction, folder: Path) -> None:
    """Write `report.png`: held-out photos beside splat and mesh, and the circle of cameras from above.

    The folder contains the photos' previews; a photo without one is left out.
    """
    previews = read_photo_previews(folder)
    cameras = {one.photo: one.camera for one in result.cameras}
    compared = [name for name in photos_to_compare(result.report["held_out"]) if name in previews]
    rows = [comparison_row(result.mesh, result.scene, cameras[name], previews[name]) for name in compared]
    rows.append(circle_picture(camera_circle(cameras), _REPORT_SIDE_PX))
    width = max(row.shape[1] for row in rows)
    padded = [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255) for row in rows]
    with (folder / "report.png").open("wb") as stream:
        write_png(np.concatenate(padded), stream)


class PlantQuality(NamedTuple):
    """PSNR of held-out photos in the pixels that the plant's Gaussians cover [dB]; 0 if there are none."""

    with_db: float  # PSNR of the whole scene
    without_db: float  # PSNR of the scene without the plant
    one_color_db: float  # PSNR of the photo's mean colour in these pixels

    @property
    def is_plant(self) -> bool:
        """Whether the plant's Gaussians improve the match with the photos, beyond that of one colour."""
        return self.with_db >= max(self.without_db + LEAST_GAIN_DB, self.one_color_db) > 0


def plant_quality(result: Reconstruction, folder: Path) -> PlantQuality | None:
    """Measure the scene's PSNR in held-out photos where the plant is visible; None if no photo has a preview."""
    plant_side_px = 320
    previews, scene, plant = read_photo_previews(folder), result.scene, result.own
    cameras = {one.photo: one.camera for one in result.cameras}
    names = [name for name in photos_to_compare(result.report["held_out"]) if name in previews]
    photos = [(cameras[name], downscaled_picture(previews[name], plant_side_px)) for name in names]
    values = []
    for camera, photo in photos:
        height, width = photo.shape[:2]
        alone, whole, others = (
            render_cloud(cloud, camera, width=width, height=height)
            for cloud in (scene.subset(plant), scene, scene.subset(~plant))
        )
        mask = alone.alpha > _INSIDE
        if mask.any():
            wanted, *pictures = (
                picture[mask].astype(np.float32) / 255
                for picture in (photo, whole.over((0.0, 0.0, 0.0)), others.over((0.0, 0.0, 0.0)))
            )
            pictures.append(np.broadcast_to(wanted.mean(axis=0), wanted.shape))
            values.append([psnr(picture, wanted) for picture in pictures])
    return PlantQuality(*np.mean(values or [[0.0] * 3], axis=0).tolist()) if photos else None


def comparison_row(
    mesh: TriangleMesh, scene: GaussianCloud, camera: Camera, photo: UInt8[np.ndarray, "H W 3"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw a photo, the splat and the mesh side by side, from the same camera and at the same size."""
    small = downscaled_picture(photo, _REPORT_SIDE_PX)
    height, width = small.shape[:2]
    splat = render_cloud(scene, camera, width=width, height=height).over((0.0, 0.0, 0.0))
    surface = Renderer(mesh, RenderSettings(width=width, height=height, ground=False)).picture(camera=camera)
    return np.concatenate([small, splat, surface], axis=1)


def downscaled_picture(picture: UInt8[np.ndarray, "H W 3"], side_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """Reduce a picture to at most `side_px` pixels per side."""
    image = Image.fromarray(picture)
    image.thumbnail((side_px, side_px), Image.Resampling.LANCZOS)
    return np.array(image)
