"""Cut the plant out of a finished reconstruction, and give it another height, without learning again."""

import json
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64

from dynamictree.errors import InputError, MeshError
from dynamictree.files import opened
from dynamictree.formats.mesh.ply import read_ply_mesh
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import read_gaussian_ply, write_gaussian_ply
from dynamictree.gaussian.capture import Capture, carrying_mesh, with_still_parts
from dynamictree.gaussian.cloud import GaussianCloud, in_box
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.cut import of_the_tree
from dynamictree.requests import Box

_LEAST_FACES = 50
_LEAST_GAUSSIANS = 50
_CELLS = 320  # along the longest side of a surface that is made anew
_PICTURES = ("report.png",)


@dataclass(frozen=True, kw_only=True)
class Finished:
    """Files of a finished reconstruction, as `report.write_result` writes them."""

    mesh: TriangleMesh
    scene: GaussianCloud
    cameras: dict[str, Any]
    report: dict[str, Any]

    def moved(self, scale: float, origin: Float64[np.ndarray, "3"]) -> "Finished":
        """Scale about a point, which becomes the origin."""

        def points(values: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, "N 3"]:
            moved: Float32[np.ndarray, "N 3"] = (scale * (values - origin)).astype(np.float32)
            return moved

        cameras = [
            camera | {"position_m": (scale * (np.array(camera["position_m"]) - origin)).tolist()}
            for camera in self.cameras["cameras"]
        ]
        return Finished(
            mesh=replace(self.mesh, vertices=points(self.mesh.vertices)),
            scene=replace(self.scene, means=points(self.scene.means), scales=self.scene.scales * np.float32(scale)),
            cameras=self.cameras | {"cameras": cameras},
            report=self.report | {"radius_m": scale * self.report["radius_m"]},
        )


def recut(source: Path, target: Path, *, box_m: Box | None = None, height_m: float | None = None) -> Capture:
    """Write the files of a finished reconstruction again, of what is in a box alone, and as high as asked for.

    What is in the box stands on z = 0 afterwards. Without a box the mesh stays as it is, without a height the scale.

    Args:
        source: folder of a finished reconstruction.
        target: folder for the files; may be the same.
        box_m: low and high corner, in the frame of the files in `source`.
        height_m: of the plant in the box: of the mesh without pots, ground and what else is found to be no plant.

    Raises:
        InputError: the folder holds no reconstruction, or the box no plant.
    """
    finished = _read(source)
    mesh, places = finished.mesh, finished.mesh.vertices
    own = np.ones(finished.scene.num_gaussians, np.bool_)
    if box_m is not None:
        own = in_box(finished.scene, *box_m)
        mesh, places = _mesh_in(box_m, finished.mesh, finished.scene.subset(own))
    own &= of_the_tree(finished.scene, places, radius_m=finished.report["radius_m"])
    if own.sum() < _LEAST_GAUSSIANS:
        raise InputError(f"{int(own.sum())} Gaussians of a plant are in the box; at least {_LEAST_GAUSSIANS} must be")
    scale = 1.0 if height_m is None else height_m / _plant_height(finished.scene.subset(own), mesh)
    ground = np.array([0.0, 0.0, 0.0 if box_m is None else mesh.vertices[:, 2].min()])
    moved = replace(finished, mesh=mesh).moved(scale, ground)
    origin_of_scale = "unknown" if height_m is None and finished.report["scale"] == "unknown" else "given"
    moved.cameras["scale"] = origin_of_scale
    moved.report.update(
        scale=origin_of_scale,
        height_m=moved.mesh.height_m,
        num_vertices=moved.mesh.num_vertices,
        num_faces=moved.mesh.num_faces,
        num_gaussians=int(own.sum()),
    )
    plant = moved.scene.subset(own)
    _write(moved, plant, target)
    for name in _PICTURES:
        if source != target:
            (target / name).write_bytes((source / name).read_bytes())
    return Capture(cloud=plant, mesh=moved.mesh)


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
        scene = read_gaussian_ply(stream)
    return Finished(mesh=mesh, scene=scene, cameras=json.loads((folder / "cameras.json").read_text()), report=report)


def _write(finished: Finished, plant: GaussianCloud, folder: Path) -> None:
    with (folder / "mesh.ply").open("wb") as stream:
        write_ply(finished.mesh, stream)
    with (folder / "splat.ply").open("wb") as stream:
        write_gaussian_ply(plant, stream)
    with (folder / "scene.ply").open("wb") as stream:
        write_gaussian_ply(finished.scene, stream)
    (folder / "cameras.json").write_text(json.dumps(finished.cameras, indent=1))
    (folder / "report.json").write_text(json.dumps(finished.report, indent=1))


def _plant_height(cloud: GaussianCloud, mesh: TriangleMesh) -> float:
    """Height of the faces that are no still part [m]."""
    carrying = carrying_mesh(with_still_parts(Capture(cloud=cloud, mesh=mesh)))
    faces = mesh.faces if carrying.still_faces is None else mesh.faces[~carrying.still_faces]
    return float(np.ptp(mesh.vertices[faces, 2]))


def _mesh_in(box_m: Box, mesh: TriangleMesh, cloud: GaussianCloud) -> tuple[TriangleMesh, Float32[np.ndarray, "M 3"]]:
    """The part of the mesh in the box, or the surface of the Gaussians there; and places that the plant is near to."""
    low, high = np.array(box_m)
    inside: Bool[np.ndarray, " N"] = np.all((mesh.vertices >= low) & (mesh.vertices <= high), axis=1)
    faces = mesh.faces[inside[mesh.faces].all(axis=1)]
    if len(faces) < _LEAST_FACES:
        try:
            return mesh_of_cloud(cloud, cells_along=_CELLS), cloud.means
        except (InputError, MeshError, ValueError) as error:
            raise InputError(f"nothing in the box from {box_m[0]} to {box_m[1]} has a surface; enlarge it") from error
    used, rows = np.unique(faces, return_inverse=True)
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[used]
    cropped = TriangleMesh(
        vertices=mesh.vertices[used], faces=rows.reshape(-1, 3).astype(np.int32), vertex_colors=colors
    )
    return cropped, cropped.vertices
