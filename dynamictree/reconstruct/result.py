"""Result of a reconstruction: mesh, splat, cameras, and a report on their quality."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
from jaxtyping import Bool, Float32, Float64

from dynamictree.errors import InputError
from dynamictree.files import open_input
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.mesh.ply import read_ply_mesh
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.photo_cameras import PhotoCamera, read_cameras, write_cameras


class MarkerReport(TypedDict):
    """Printed marker detected in the photos."""

    number: int
    edge_m: float  # edge of its black square, measured in the result
    num_photos: int  # number of photos that agree on its position


class SplatFigures(TypedDict):
    """Quality of the splat in held-out photos, which the optimisation did not use."""

    held_out: list[str]  # names of the held-out photos
    held_out_psnr_db: list[float]  # PSNR of each photo
    held_out_masked_psnr_db: list[float]  # PSNR inside the mask; empty without masks
    held_out_ssim: list[float]
    held_out_blank_psnr_db: list[float]  # PSNR of a picture of one colour, for comparison
    held_out_size_px: list[int]
    splat_steps: int
    num_gaussians_discarded: int  # Gaussians whose gradient was not finite


class Report(SplatFigures):
    """Contents of `report.json`."""

    num_photos: int
    num_registered: int
    left_out: list[str]  # photos without a camera
    left_out_because: dict[str, str]  # reason for each, as a sentence
    reprojection_error_px: float
    num_points: int
    ground_found: bool
    scale: str  # `given`, `marker` or `unknown`; a mesh of unknown scale is 1 m high
    markers: list[MarkerReport]  # markers in at least three photos, most photos first
    height_m: float
    radius_m: float  # radius of the region that the photos show
    mesh_by: str  # `stereo` or `splat`: from depth maps or from the splat's opacity
    num_vertices: int
    num_faces: int
    num_gaussians: int  # Gaussians of the tree
    num_gaussians_scene: int
    camera_azimuths_deg: dict[str, float]  # azimuth by photo, ascending, counter-clockwise seen from above
    largest_gap_deg: float  # largest angle between neighbouring cameras around the plant
    beside_largest_gap: list[str]  # the two photos at the ends of the largest gap
    warnings: list[str]  # reasons to doubt the result, with advice
    seconds: dict[str, float]  # duration of each stage
    processor_seconds: dict[str, float]  # processor time of each stage, all cores
    plant_psnr_db: float | None  # PSNR of held-out photos where the plant is visible; None unless it was cut out
    without_plant_psnr_db: float | None  # the same for the scene without the plant
    plant_blank_psnr_db: float | None  # the same for one colour


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """Mesh, all Gaussians and the photos' cameras [m, +Z up, the mesh standing on z = 0], with a quality report."""

    mesh: TriangleMesh
    scene: GaussianCloud
    own: Bool[np.ndarray, " G"]  # mask of the Gaussians that belong to the mesh
    cameras: list[PhotoCamera]
    report: Report

    @property
    def splat(self) -> GaussianCloud:
        """The Gaussians that belong to the mesh."""
        return self.scene.subset(self.own)

    def moved(self, scale: float, origin: Float64[np.ndarray, "3"]) -> "Reconstruction":
        """Return the reconstruction scaled about a point, which becomes the origin."""

        def points(values: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, "N 3"]:
            return np.asarray(scale * (values - origin), np.float32)

        cameras = [
            replace(one, camera=replace(one.camera, position_m=scale * (one.camera.position_m - origin)))
            for one in self.cameras
        ]
        report = self.report.copy()
        report["radius_m"] = scale * report["radius_m"]
        report["markers"] = [{**marker, "edge_m": scale * marker["edge_m"]} for marker in report.get("markers", [])]
        return replace(
            self,
            mesh=self.mesh.with_vertices(points(self.mesh.vertices)),
            scene=replace(self.scene, means=points(self.scene.means), scales=self.scene.scales * np.float32(scale)),
            cameras=cameras,
            report=report,
        )

    def write(self, folder: Path) -> None:
        """Write `mesh.ply`, `splat.ply`, `scene.ply`, `cameras.json` and `report.json`; add sizes to the report."""
        self.report.update(
            {
                "height_m": self.mesh.height_m,
                "num_vertices": self.mesh.num_vertices,
                "num_faces": self.mesh.num_faces,
                "num_gaussians": int(self.own.sum()),
                "num_gaussians_scene": self.scene.num_gaussians,
            }
        )
        with (folder / "mesh.ply").open("wb") as stream:
            write_ply(self.mesh, stream)
        for name, cloud in (("splat.ply", self.splat), ("scene.ply", self.scene)):
            with (folder / name).open("wb") as stream:
                write_gaussian_ply(cloud, stream)
        write_cameras(self.cameras, folder, scale=self.report["scale"])
        (folder / "report.json").write_text(json.dumps(self.report, indent=1))

    @staticmethod
    def read(folder: Path) -> "Reconstruction":
        """Read the files that `write` wrote; all Gaussians belong to the mesh.

        Raises:
            InputError: the folder contains no reconstruction.
        """
        if not (folder / "report.json").is_file():
            raise InputError(f"{folder} holds no report.json; name the output folder of `dynamictree reconstruct`")
        with open_input(folder / "mesh.ply") as stream:
            mesh = read_ply_mesh(stream.read(), companions={})
        with open_input(folder / "scene.ply") as stream:
            scene = read_cloud(stream, file_type="ply")
        return Reconstruction(
            mesh=mesh,
            scene=scene,
            own=np.ones(scene.num_gaussians, np.bool_),
            cameras=read_cameras(json.loads((folder / "cameras.json").read_text())),
            report=json.loads((folder / "report.json").read_text()),
        )
