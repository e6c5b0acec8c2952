"""Cut the plant out of a finished reconstruction, and rescale it, without optimising again."""

import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud, in_box
from dynamictree.mesh import TriangleMesh
from dynamictree.photo_requests import CutParams
from dynamictree.plant.capture import Capture, carrying_mesh, with_still_parts
from dynamictree.reconstruct.coloured_mesh import mesh_of_plant
from dynamictree.reconstruct.photo_previews import PHOTO_PREVIEWS
from dynamictree.reconstruct.plant_cut import background_coloured, faint_floaters, plant_of
from dynamictree.reconstruct.report import PlantQuality, plant_quality, write_report_picture
from dynamictree.reconstruct.result import Reconstruction
from dynamictree.reconstruct.surface_choice import gaussians_near_mesh


def recut(
    source: Path, target: Path, choice: CutParams, *, on_progress: Callable[[float], None] = lambda share: None
) -> Capture:
    """Write the files of a finished reconstruction again, cut to the plant and scaled to the requested height.

    The plant is selected by a box, by strokes on photos (`plant_of`), or by both. A cut moves the plant to stand on
    z = 0. Without a cut the mesh is unchanged; without a height the scale is.

    Args:
        source: folder of a finished reconstruction.
        target: folder for the files, which may be `source`.
        choice: the box, in the frame of the files in `source`; strokes; and the plant's height, which excludes pots,
            ground and other still parts.
        on_progress: called with the completed share; if it raises, the exception propagates and no file is written.

    Raises:
        InputError: the folder contains no reconstruction, or box and strokes select no plant.
    """
    finished = Reconstruction.read(source)
    finished = _cut_out(finished, choice, lambda share: on_progress(0.1 + 0.8 * share))
    on_progress(0.9)
    scale, finished.report["scale"] = _scale(finished, choice)
    ground = np.array([0.0, 0.0, finished.mesh.vertices[:, 2].min() if choice.cuts else 0.0])
    moved = finished.moved(scale, ground)
    for name in (PHOTO_PREVIEWS, "report.png"):
        if source != target and (source / name).exists():  # earlier versions wrote no previews of photos
            (target / name).write_bytes((source / name).read_bytes())
    if choice.cuts:
        _judge_plant(moved, plant_quality(moved, target), choice)
    moved.write(target)
    if choice.cuts:
        write_report_picture(moved, target)
    return Capture(cloud=moved.splat, mesh=moved.mesh)


def _judge_plant(finished: Reconstruction, quality: PlantQuality | None, choice: CutParams) -> None:
    """Add the plant's PSNR in held-out photos to the report; reject a found plant without which they are as good."""
    if quality is None:
        return
    with_db, without_db, one_color_db = (round(value, 2) for value in quality)
    finished.report.update(
        {"plant_psnr_db": with_db, "without_plant_psnr_db": without_db, "plant_blank_psnr_db": one_color_db}
    )
    if quality.is_plant:
        return
    problem = (
        f"where the plant was found, photos held out are shown with {with_db:.1f} dB, with {without_db:.1f} dB "
        f"without it and with {one_color_db:.1f} dB by one colour: the splat shows no plant there"
    )
    if not choice.scribbles and choice.box_m is None:
        advice = " ".join(finished.report["warnings"]) or "take more photos, sharp and in even light"
        raise InputError(f"{problem}; draw strokes on the plant, or reconstruct without only_plant to look; {advice}")
    finished.report["warnings"] = [*finished.report["warnings"], problem]


def _cut_out(finished: Reconstruction, choice: CutParams, on_progress: Callable[[float], None]) -> Reconstruction:
    """Cut the reconstruction to the plant's Gaussians and mesh."""
    scene, radius_m = finished.scene, finished.report["radius_m"]
    if not choice.cuts:
        return replace(finished, own=gaussians_near_mesh(scene, finished.mesh, radius=radius_m))
    own = np.ones(scene.num_gaussians, np.bool_) if choice.box_m is None else in_box(scene.means, choice.box_m)
    if choice.scribbles or choice.only_plant:
        masked = bool(finished.report.get("held_out_masked_psnr_db"))
        own &= plant_of(
            scene,
            finished.cameras,
            choice.scribbles or (),
            masked=masked,
            on_progress=lambda share: on_progress(0.6 * share),
        )
        _require_plant(own)
        on_progress(0.6)
        if not masked:  # masks leave no floaters, but twigs that look like them
            own &= ~background_coloured(scene, own, finished.cameras)
            own &= ~faint_floaters(scene, own)
        on_progress(0.8)
    mesh = mesh_of_plant(scene, own, finished.mesh, radius_m)
    finished.report["mesh_by"] = "splat"
    if not (choice.scribbles or choice.only_plant):
        own &= gaussians_near_mesh(scene, mesh, radius=radius_m)
    _require_plant(own)
    return replace(finished, own=own, mesh=mesh)


def _scale(finished: Reconstruction, choice: CutParams) -> tuple[float, str]:
    """Return the factor by which the result is scaled, and its source: `given`, `marker`, or as before."""
    if choice.height_m is not None:
        return choice.height_m / _plant_height(finished.splat, finished.mesh), "given"
    if choice.marker_m is None:
        return 1.0, finished.report["scale"]
    markers = finished.report.get("markers", ())
    if not markers:
        raise InputError(
            "no marker was found in three photos; lay the sheet flat beside the plant, all of its white border in the "
            "picture and the square at least 30 pixels wide, or give height_m"
        )
    return choice.marker_m / markers[0]["edge_m"], "marker"


def _require_plant(own: Bool[np.ndarray, " G"]) -> None:
    least_gaussians = 50
    if own.sum() < least_gaussians:
        problem = f"{int(own.sum())} Gaussians of a plant are in the cut; at least {least_gaussians} must be"
        raise InputError(f"{problem}; draw strokes on the plant, or reconstruct without only_plant to look")


def pack_folder(folder: Path, archive: Path) -> None:
    """Put the files of a reconstruction into a ZIP archive."""
    with zipfile.ZipFile(archive, "w") as packed:
        for path in sorted(folder.iterdir()):
            if path.is_file() and not path.name.startswith("."):
                packed.write(path, path.name)


def unpack_folder(archive: Path, folder: Path) -> None:
    """Extract the files that `pack_folder` stored."""
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder)


def _plant_height(cloud: GaussianCloud, mesh: TriangleMesh) -> float:
    """Return the height of the faces that can move [m]."""
    carrying = carrying_mesh(with_still_parts(Capture(cloud=cloud, mesh=mesh)))
    faces = mesh.faces if carrying.still_faces is None else mesh.faces[~carrying.still_faces]
    return float(np.ptp(mesh.vertices[faces, 2]))
