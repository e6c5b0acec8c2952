"""Files of a reconstruction: products, numbers, cameras, and held-out photos beside the splat and the mesh."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.photo_previews import write_photo_previews
from dynamictree.reconstruct.result import Reconstruction
from dynamictree.reconstruct.splat import SplatFit
from dynamictree.reconstruct.views import View
from dynamictree.render import Camera, Look, Renderer, write_png

_REPORT_SIDE_PX = 640


_LEAST_GAIN_DB = 3.0  # above a picture of one colour, or the splat shows nothing


def quality_warnings(psnr_db: Sequence[float], blank_psnr_db: Sequence[float]) -> list[str]:
    """Warn if the held-out photos are shown hardly better than by pictures of one colour."""
    reached, blank = float(np.mean(psnr_db)), float(np.mean(blank_psnr_db))
    if reached >= blank + _LEAST_GAIN_DB:
        return []
    return [
        f"photos held out are shown with {reached:.1f} dB, a picture of one colour has {blank:.1f} dB: do not trust "
        "the splat; look at report.png, check masks and given cameras, and take more photos, sharp and in even light"
    ]


def write_result(result: Reconstruction, fit: SplatFit, folder: Path) -> None:
    """Write `mesh.ply`, `splat.ply`, `scene.ply`, cameras, previews of photos, `report.json` and `report.png`."""
    with (folder / "mesh.ply").open("wb") as stream:
        write_ply(result.mesh, stream)
    with (folder / "splat.ply").open("wb") as stream:
        write_gaussian_ply(result.splat, stream)
    with (folder / "scene.ply").open("wb") as stream:
        write_gaussian_ply(result.scene, stream)
    write_cameras(result.views, folder, scale=result.report["scale"])
    write_photo_previews(result.views, folder)
    (folder / "report.json").write_text(json.dumps(result.report, indent=1))
    by_name = {view.source: view for view in result.views}
    rows = [
        comparison_row(result.mesh, by_name[name].camera, pair)
        for name, pair in zip(fit.held_out, fit.pictures, strict=True)
    ]
    width = max(row.shape[1] for row in rows)
    padded = [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255) for row in rows]
    with (folder / "report.png").open("wb") as stream:
        write_png(np.concatenate(padded), stream)


def write_cameras(views: Sequence[View], folder: Path, *, scale: str) -> None:
    """Write `cameras.json`: intrinsics and pose of each registered photo."""
    cameras = {
        "axes": "camera x right, y down, z forward; world +Z up; pixel centres at half-integers",
        "scale": scale,
        "cameras": [_camera_fields(view) for view in views],
    }
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1))


def comparison_row(mesh: TriangleMesh, camera: Camera, pair: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """A photo and the splat's picture side by side (`pair`), and the mesh from the same camera at the same size."""
    shrunk = _shrunk(pair, 2 * _REPORT_SIDE_PX)
    look = Look(width=shrunk.shape[1] // 2, height=shrunk.shape[0], ground=False)
    return np.concatenate([shrunk, Renderer(mesh, look).picture(camera=camera)], axis=1)


def _shrunk(picture: UInt8[np.ndarray, "H W 3"], width: int) -> UInt8[np.ndarray, "h w 3"]:
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
