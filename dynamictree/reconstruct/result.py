"""Result of a reconstruction: mesh, splat, cameras, and a report of how good they are."""

from dataclasses import dataclass
from typing import TypedDict

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.views import View


class MarkerReport(TypedDict):
    """A printed marker in the photos."""

    number: int
    edge_m: float  # of its black square, as measured in the result
    num_photos: int  # that it was placed by


class SplatFigures(TypedDict):
    """How well the splat shows photos that it was not learned from."""

    held_out: list[str]  # photos that the splat was not learned from and that judge it
    chosen_by: list[str]  # photos that chose the best of its states, and are neither learned from nor held out
    held_out_psnr_db: list[float]  # of each
    held_out_masked_psnr_db: list[float]  # inside the mask; empty without masks
    held_out_ssim: list[float]
    held_out_blank_psnr_db: list[float]  # of a picture of one colour, for comparison
    held_out_size_px: list[int]
    splat_steps: int
    num_gaussians_discarded: int  # since their gradient was not finite


class Report(SplatFigures):
    """Contents of `report.json`."""

    num_photos: int
    num_registered: int
    left_out: list[str]  # photos without a camera
    left_out_because: dict[str, str]  # a sentence on each
    reprojection_error_px: float
    num_points: int
    ground_found: bool
    scale: str  # `given`, `marker` or `unknown`: photos alone tell no size, a mesh of unknown scale is 1 m high
    markers: list[MarkerReport]  # found in at least three photos, those in most photos first
    height_m: float
    radius_m: float  # of the region that the photos look at
    mesh_by: str  # `stereo` or `splat`: made from depth maps or from the splat's opacity
    num_vertices: int
    num_faces: int
    num_gaussians: int  # of the tree
    num_gaussians_scene: int
    camera_azimuths_deg: dict[str, float]  # seen from above, counter-clockwise, in that order; by photo
    largest_gap_deg: float  # between neighbouring cameras around the plant
    beside_largest_gap: list[str]  # the two photos at its ends
    warnings: list[str]  # what makes the result doubtful, and what to do
    seconds: dict[str, float]  # by stage
    processor_seconds: dict[str, float]  # by stage, of all cores


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """The tree as mesh and as splat, the whole scene, and the cameras [m, +Z up, standing on z = 0]."""

    mesh: TriangleMesh
    splat: GaussianCloud
    scene: GaussianCloud
    views: tuple[View, ...]
    report: Report
