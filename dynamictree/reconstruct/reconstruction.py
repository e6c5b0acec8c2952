"""A folder of photos in, a coarse coloured mesh out, with its cameras and a report."""

import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from dynamictree.errors import InputError
from dynamictree.formats.ply_writer import write_ply
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.cameras import find_cameras
from dynamictree.reconstruct.photos import prepare_photos
from dynamictree.reconstruct.surface import find_shape
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.render import Look, Renderer, write_png

UNKNOWN_HEIGHT_M = 1.0  # what photos alone cannot tell
_REPORT_SIDE_PX = 640
_PREPARED, _MAPPED = 0.04, 0.5  # shares of the whole


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
    num_vertices: int
    num_faces: int
    seconds: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """The mesh, its cameras in the mesh's frame, and how it went."""

    mesh: TriangleMesh
    views: tuple[View, ...]
    report: Report


def reconstruct(
    photos: Sequence[Path],
    folder: Path,
    *,
    height_m: float | None = None,
    on_progress: Callable[[float], None] = lambda done: None,
) -> Reconstruction:
    """Write `mesh.ply`, `cameras.json`, `report.json` and `report.png` into the folder; metres, +Z up, on the ground.

    The height is that of what is meshed [m]; without one the mesh is 1 m high and the report calls its scale unknown.
    The callback gets the share that is done, every quarter of a second at least while cameras are sought and once a
    photo otherwise; what it raises stops the work, leaves no process and no file, and passes through.

    Raises:
        InputError: too few or too many photos, one that cannot be used, or a height that is not positive.
        ReconstructionError: the photos do not fit together or show no surface.
    """
    if height_m is not None and not 0 < height_m < 1000:
        raise InputError(f"height_m is {height_m}; above 0 and below 1000 is allowed")
    seconds: dict[str, float] = {}
    with tempfile.TemporaryDirectory(dir=folder, prefix="work-") as name:
        work = Path(name)
        with _timed(seconds, "photos"):
            prepared = prepare_photos(
                photos, work / "photos", on_photo=lambda done, total: on_progress(_PREPARED * done / total)
            )
        with _timed(seconds, "cameras"):
            model = find_cameras(
                prepared, work, on_progress=lambda done: on_progress(_PREPARED + (_MAPPED - _PREPARED) * done)
            )
    with _timed(seconds, "surface"):
        shape = find_shape(
            model,
            height_m=height_m or UNKNOWN_HEIGHT_M,
            on_progress=lambda done: on_progress(_MAPPED + (1 - _MAPPED) * done),
        )
    registered = {view.source for view in shape.model.views}
    report = Report(
        num_photos=len(photos),
        num_registered=len(shape.model.views),
        left_out=[path.name for path in photos if path.name not in registered],
        reprojection_error_px=model.reprojection_error_px,
        num_points=len(model.points),
        ground_found=shape.ground_found,
        scale="unknown" if height_m is None else "given",
        height_m=shape.mesh.height_m,
        num_vertices=shape.mesh.num_vertices,
        num_faces=shape.mesh.num_faces,
        seconds={step: round(taken, 2) for step, taken in seconds.items()},
    )
    found = Reconstruction(mesh=shape.mesh, views=shape.model.views, report=report)
    _write(found, shape.model, folder)
    on_progress(1.0)
    return found


def beside_photo(mesh: TriangleMesh, view: View) -> UInt8[np.ndarray, "H W 3"]:
    """A photo, and the mesh seen by the same camera."""
    photo = Image.fromarray(view.image)
    photo.thumbnail((_REPORT_SIDE_PX, _REPORT_SIDE_PX), Image.Resampling.LANCZOS)
    look = Look(width=photo.width, height=photo.height, ground=False)
    return np.concatenate([np.asarray(photo), Renderer(mesh, look).picture(camera=view.camera)], axis=1)


def _write(found: Reconstruction, model: SparseModel, folder: Path) -> None:
    with (folder / "mesh.ply").open("wb") as stream:
        write_ply(found.mesh, stream)
    cameras = {
        "axes": "camera x right, y down, z forward; world +Z up; pixel centres at half-integers",
        "scale": found.report["scale"],
        "cameras": [_camera_fields(view) for view in found.views],
    }
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1))
    (folder / "report.json").write_text(json.dumps(found.report, indent=1))
    num_seen = np.bincount(model.seen[:, 0], minlength=len(found.views))
    shown = [found.views[int(view)] for view in np.argsort(-num_seen, kind="stable")]
    # the view of most points, and the one that looks from the farthest side of it
    opposite = max(shown, key=lambda view: float(np.linalg.norm(view.camera.position_m - shown[0].camera.position_m)))
    pictures = [beside_photo(found.mesh, view) for view in (shown[0], opposite)]
    width = max(picture.shape[1] for picture in pictures)
    padded = [np.pad(p, ((0, 0), (0, width - p.shape[1]), (0, 0)), constant_values=255) for p in pictures]
    with (folder / "report.png").open("wb") as stream:
        write_png(np.concatenate(padded), stream)


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


@contextmanager
def _timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[step] = time.perf_counter() - start
