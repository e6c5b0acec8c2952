"""What the report says of a reconstruction."""

import numpy as np
import pytest

from dynamictree.errors import ReconstructionError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.coloured_mesh import Shape
from dynamictree.reconstruct.cut import cloud_in_metres
from dynamictree.reconstruct.reconstruction import own_gaussians
from dynamictree.reconstruct.report import comparison_row, quality_warnings
from dynamictree.reconstruct.splat_table import table_of_points
from dynamictree.reconstruct.views import SparseModel
from tests.reconstruct.finished import tube


def test_a_splat_hardly_better_than_one_colour_is_warned_of():
    (warning,) = quality_warnings([14.0, 15.8], [12.0, 12.0])
    assert "14.9 dB, a picture of one colour has 12.0 dB" in warning
    assert quality_warnings([14.0, 16.2], [12.0, 12.0]) == []


def test_photo_splat_and_mesh_are_shown_at_one_size(orbit):
    scene = cloud_in_metres(_gaussians_at(orbit.stump.vertices), 1.0, np.zeros(3))
    row = comparison_row(orbit.stump, scene, orbit.cameras[0], np.zeros((900, 1200, 3), np.uint8))
    assert row.shape == (480, 3 * 640, 3)
    assert row[:, 640:1280].any()
    assert row[:, 1280:].any()


def _gaussians_at(places: np.ndarray) -> np.ndarray:
    return table_of_points(
        places, np.ones_like(places), np.full(len(places), 0.01, np.float32), opacity=0.9, sh_degree=0
    )


def test_wrong_cameras_are_named_where_next_to_nothing_lies_on_the_mesh() -> None:
    points, faces = tube(0.1, 0.0, 1.0)
    mesh = TriangleMesh(vertices=points.astype(np.float32), faces=faces.astype(np.int32))
    model = SparseModel(
        views=(),
        points=np.zeros((0, 3)),
        colors=np.zeros((0, 3), np.uint8),
        seen=np.zeros((0, 2), np.int64),
        reprojection_error_px=0.3,
    )
    shape = Shape(mesh=mesh, model=model, ground_found=True, scale=1.0, origin=np.zeros(3))

    def scene(number: int) -> GaussianCloud:
        places = np.concatenate([mesh.vertices[:number], np.float32([[5, 5, 5]] * 100)])
        return cloud_in_metres(_gaussians_at(places), 1.0, np.zeros(3))

    assert own_gaussians(scene(50), shape).sum() == 50
    with pytest.raises(ReconstructionError, match="49 Gaussians lie on the mesh; at least 50 must; the cameras may be"):
        own_gaussians(scene(49), shape)
