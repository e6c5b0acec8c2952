"""Cut the plant out of a finished reconstruction, and give it another height, without learning again."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64

from dynamictree.errors import InputError
from dynamictree.files import opened
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.mesh.ply import read_ply_mesh
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud, in_box
from dynamictree.mesh import TriangleMesh
from dynamictree.photo_requests import CutParams
from dynamictree.plant.capture import Capture, carrying_mesh, with_still_parts
from dynamictree.reconstruct.cut import of_the_tree
from dynamictree.reconstruct.cut_mesh import mesh_in_box, plant_mesh
from dynamictree.reconstruct.floaters import faint_floaters
from dynamictree.reconstruct.photo_cameras import PhotoCamera, read_cameras, write_cameras
from dynamictree.reconstruct.photo_previews import PHOTO_PREVIEWS
from dynamictree.reconstruct.plant_cut import plant_of
from dynamictree.reconstruct.report import PlantQuality, photos_to_compare, plant_quality, write_report_picture

_LEAST_GAUSSIANS = 50


@dataclass(frozen=True, kw_only=True)
class Finished:
    """Files of a finished reconstruction, as `report.write_result` writes them."""

    mesh: TriangleMesh
    scene: GaussianCloud
    cameras: list[PhotoCamera]
    report: dict[str, Any]

    def moved(self, scale: float, origin: Float64[np.ndarray, "3"]) -> "Finished":
        """Scale about a point, which becomes the origin."""

        def points(values: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, "N 3"]:
            moved: Float32[np.ndarray, "N 3"] = (scale * (values - origin)).astype(np.float32)
            return moved

        cameras = [
            replace(one, camera=replace(one.camera, position_m=scale * (one.camera.position_m - origin)))
            for one in self.cameras
        ]
        markers = [marker | {"edge_m": scale * marker["edge_m"]} for marker in self.report.get("markers", ())]
        return Finished(
            mesh=replace(self.mesh, vertices=points(self.mesh.vertices)),
            scene=replace(self.scene, means=points(self.scene.means), scales=self.scene.scales * np.float32(scale)),
            cameras=cameras,
            report=self.report | {"radius_m": scale * self.report["radius_m"], "markers": markers},
        )


def recut(
    source: Path, target: Path, choice: CutParams, *, on_progress: Callable[[float], None] = lambda share: None
) -> Capture:
    """Write the files of a finished reconstruction again, of the plant alone, and as high as asked for.

    The plant is what is in a box, what strokes on photos say (`plant_of`), or both. What is cut out stands on z = 0
    afterwards. Without a cut the mesh stays as it is, without a height the scale.

    Args:
        source: folder of a finished reconstruction.
        target: folder for the files; may be the same.
        choice: the box, in the frame of the files in `source`; strokes; and the height of the plant: of the mesh
            without pots, ground and what else is found to be no plant.
        on_progress: gets the share that is done; what it raises passes through, and no file is written.

    Raises:
        InputError: the folder holds no reconstruction, or box and strokes no plant.
    """
    finished = _read(source)
    own, mesh = _cut_out(finished, choice, lambda share: on_progress(0.1 + 0.8 * share))
    on_progress(0.9)
    scale, origin_of_scale = _scale(finished, choice, own, mesh)
    ground = np.array([0.0, 0.0, mesh.vertices[:, 2].min() if choice.cuts else 0.0])
    moved = replace(finished, mesh=mesh).moved(scale, ground)
    moved.report.update(
        scale=origin_of_scale,
        height_m=moved.mesh.height_m,
        num_vertices=moved.mesh.num_vertices,
        num_faces=moved.mesh.num_faces,
        num_gaussians=int(own.sum()),
    )
    for name in (PHOTO_PREVIEWS, "report.png"):
        if source != target and (source / name).exists():  # earlier versions wrote no previews of photos
            (target / name).write_bytes((source / name).read_bytes())
    cameras = {view.photo: view.camera for view in moved.cameras}
    compared = photos_to_compare(moved.report.get("held_out", []))
    if choice.cuts:
        _judge_plant(moved, plant_quality(target, moved.scene, own, cameras, compared), choice)
    plant = moved.scene.subset(own)
    _write(moved, plant, target)
    if choice.cuts:
        write_report_picture(target, moved.mesh, moved.scene, cameras, compared)
    return Capture(cloud=plant, mesh=moved.mesh)


def _judge_plant(finished: Finished, quality: PlantQuality | None, choice: CutParams) -> None:
    """Add to the report how well held-out photos show the plant, or refuse a plant that they do not show.

    Raises:
        InputError: nobody has marked the plant, and photos held out look hardly worse without what was found.
    """
    if quality is None:
        return
    with_db, without_db, one_color_db = (round(value, 2) for value in quality)
    finished.report.update(plant_psnr_db=with_db, without_plant_psnr_db=without_db, plant_blank_psnr_db=one_color_db)
    if quality.is_plant:
        return
    problem = (
        f"where the plant was found, photos held out are shown with {with_db:.1f} dB, with {without_db:.1f} dB "
        f"without it and with {one_color_db:.1f} dB by one colour: the splat shows no plant there"
    )
    if not choice.scribbles and choice.box_m is None:
        advice = " ".join(finished.report.get("warnings", ())) or "take more photos, sharp and in even light"
        raise InputError(f"{problem}; draw strokes on the plant, or reconstruct without only_plant to look; {advice}")
    finished.report["warnings"] = [*finished.report.get("warnings", ()), problem]


def _cut_out(
    finished: Finished, choice: CutParams, on_progress: Callable[[float], None]
) -> tuple[Bool[np.ndarray, " G"], TriangleMesh]:
    """The plant's Gaussians and its mesh."""
    scene, radius_m = finished.scene, finished.report["radius_m"]
    mesh, places = finished.mesh, finished.mesh.vertices
    own = np.ones(scene.num_gaussians, np.bool_) if choice.box_m is None else in_box(scene, *choice.box_m)
    if choice.scribbles or choice.only_plant:
        views = finished.cameras
        own &= plant_of(scene, views, choice.scribbles or (), on_progress=lambda share: on_progress(0.6 * share))
        _require_plant(own)
        on_progress(0.6)
        if not finished.report.get("held_out_masked_psnr_db"):  # masks leave no fog, but twigs that look like it
            own &= ~faint_floaters(scene, own)
        on_progress(0.8)
        mesh = plant_mesh(mesh, scene, own, radius_m=radius_m)
    else:
        if choice.box_m is not None:
            mesh, places = mesh_in_box(choice.box_m, mesh, scene.subset(own))
        own &= of_the_tree(scene, places, radius_m=radius_m)
    _require_plant(own)
    return own, mesh


def _scale(finished: Finished, choice: CutParams, own: Bool[np.ndarray, " G"], mesh: TriangleMesh) -> tuple[float, str]:
    """By what the result is enlarged, and what says so: `given`, `marker`, or as before.

    Raises:
        InputError: the photos show no marker.
    """
    if choice.height_m is not None:
        return choice.height_m / _plant_height(finished.scene.subset(own), mesh), "given"
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
    if own.sum() < _LEAST_GAUSSIANS:
        raise InputError(f"{int(own.sum())} Gaussians of a plant are in the cut; at least {_LEAST_GAUSSIANS} must be")


def pack(folder: Path, archive: Path) -> None:
    """Put the files of a reconstruction into one."""
    with zipfile.ZipFile(archive, "w") as packed:
        for path in sorted(folder.iterdir()):
            if path.is_file() and not path.name.startswith("."):
                packed.write(path, path.name)


def unpack(archive: Path, folder: Path) -> None:
    """Undo `pack`."""
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder)


def _read(folder: Path) -> Finished:
    if not (folder / "report.json").is_file():
        raise InputError(f"{folder} holds no report.json; name the output folder of `dynamictree reconstruct`")
    report = json.loads((folder / "report.json").read_text())
    if "radius_m" not in report:
        raise InputError(f"{folder} was written by an earlier version; reconstruct the photos again")
    with opened(folder / "mesh.ply") as stream:
        mesh = read_ply_mesh(stream.read(), companions={})
    with opened(folder / "scene.ply") as stream:
        scene = read_cloud(stream, file_type="ply")
    cameras = read_cameras(json.loads((folder / "cameras.json").read_text()))
    return Finished(mesh=mesh, scene=scene, cameras=cameras, report=report)


def _write(finished: Finished, plant: GaussianCloud, folder: Path) -> None:
    with (folder / "mesh.ply").open("wb") as stream:
        write_ply(finished.mesh, stream)
    with (folder / "splat.ply").open("wb") as stream:
        write_gaussian_ply(plant, stream)
    with (folder / "scene.ply").open("wb") as stream:
        write_gaussian_ply(finished.scene, stream)
    write_cameras(finished.cameras, folder, scale=finished.report["scale"])
    (folder / "report.json").write_text(json.dumps(finished.report, indent=1))


def _plant_height(cloud: GaussianCloud, mesh: TriangleMesh) -> float:
    """Height of the faces that are no still part [m]."""
    carrying = carrying_mesh(with_still_parts(Capture(cloud=cloud, mesh=mesh)))
    faces = mesh.faces if carrying.still_faces is None else mesh.faces[~carrying.still_faces]
    return float(np.ptp(mesh.vertices[faces, 2]))
