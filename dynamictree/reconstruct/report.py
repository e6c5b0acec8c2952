"""What a reconstruction tells: numbers, cameras, and photos beside what was made of them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.views import View
from dynamictree.render import Look, Renderer, write_png

if TYPE_CHECKING:
    from dynamictree.reconstruct.reconstruction import Reconstruction
    from dynamictree.reconstruct.splat import SplatFit

_REPORT_SIDE_PX = 640


_LEAST_GAIN_DB = 3.0  # above a picture of one colour, or the splat shows nothing


class Report(TypedDict):
    """What was found, as `report.json` holds it."""

    num_photos: int
    num_registered: int
    left_out: list[str]  # photos that fit to no others
    reprojection_error_px: float
    num_points: int
    ground_found: bool
    scale: str  # `given` or `unknown`: photos alone tell no size, a mesh of unknown scale is 1 m high
    height_m: float
    mesh_by: str  # `stereo` or `splat`: whose depths or opacity it was made of
    num_vertices: int
    num_faces: int
    num_gaussians: int  # of the tree
    num_gaussians_scene: int
    held_out: list[str]  # photos that the splat was not made from; they told when to stop
    held_out_psnr_db: list[float]  # of each
    held_out_blank_psnr_db: list[float]  # of a picture of one colour, for comparison
    held_out_size_px: list[int]
    warnings: list[str]  # what makes the result doubtful, and what to do
    splat_steps: int
    num_gaussians_discarded: int  # since their gradient was not finite
    seconds: dict[str, float]  # by part
    processor_seconds: dict[str, float]  # by part, of all cores


def quality_warnings(psnr_db: Sequence[float], blank_psnr_db: Sequence[float]) -> list[str]:
    """Warn if the held-out photos are shown hardly better than by pictures of one colour."""
    shown, blank = float(np.mean(psnr_db)), float(np.mean(blank_psnr_db))
    if shown >= blank + _LEAST_GAIN_DB:
        return []
    return [
        f"photos held out are shown with {shown:.1f} dB, a picture of one colour has {blank:.1f} dB: do not trust the "
        "splat; look at report.png, check masks and given cameras, and take more photos, sharp and in even light"
    ]


def write_report(found: "Reconstruction", fit: "SplatFit", folder: Path) -> None:
    """Everything that was made, as files."""
    with (folder / "mesh.ply").open("wb") as stream:
        write_ply(found.mesh, stream)
    with (folder / "splat.ply").open("wb") as stream:
        write_gaussian_ply(found.splat, stream)
    with (folder / "scene.ply").open("wb") as stream:
        write_gaussian_ply(found.scene, stream)
    write_cameras(found.views, folder, scale=found.report["scale"])
    (folder / "report.json").write_text(json.dumps(found.report, indent=1))
    by_name = {view.source: view for view in found.views}
    rows = [
        np.concatenate([_fitting(pair, 2 * _REPORT_SIDE_PX), _mesh_seen(found.mesh, by_name[name])], axis=1)
        for name, pair in zip(fit.held_out, fit.pictures, strict=True)
    ]
    width = max(row.shape[1] for row in rows)
    padded = [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255) for row in rows]
    with (folder / "report.png").open("wb") as stream:
        write_png(np.concatenate(padded), stream)


def write_cameras(views: Sequence[View], folder: Path, *, scale: str) -> None:
    """Where each photo was taken from."""
    cameras = {
        "axes": "camera x right, y down, z forward; world +Z up; pixel centres at half-integers",
        "scale": scale,
        "cameras": [_camera_fields(view) for view in views],
    }
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1))


def _mesh_seen(mesh: TriangleMesh, view: View) -> UInt8[np.ndarray, "H W 3"]:
    height, width = view.image.shape[:2]
    by = min(1.0, _REPORT_SIDE_PX / max(width, height))
    look = Look(width=round(width * by), height=round(height * by), ground=False)
    return Renderer(mesh, look).picture(camera=view.camera)


def _fitting(picture: UInt8[np.ndarray, "H W 3"], width: int) -> UInt8[np.ndarray, "h w 3"]:
    image = Image.fromarray(picture)
    image.thumbnail((width, width), Image.Resampling.LANCZOS)
    return np.array(image)


def _camera_fields(view: View) -> dict[str, object]:
    height, width = view.image.shape[:2]
    matrix = view.camera.intrinsics_px(width, height)
    return {
        "photo": view.source,
        "width": width,
        "height": height,
        "focal_px": matrix[0, 0],
        "principal_px": matrix[:2, 2].tolist(),
        "position_m": view.camera.position_m.tolist(),
        "world_to_camera": view.camera.world_to_camera.tolist(),
    }
