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


@pytest.mark.parametrize("size", [(120, 160), (300, 400), (900, 1200)])
def test_the_mesh_is_shown_at_the_size_of_the_splats_picture(orbit, size):
    """A splat learned at 160 pixels of photos of 400: the mesh was rendered at 400, and no report was written."""
    height, width = size
    row = comparison_row(orbit.stump, orbit.cameras[0], np.zeros((height, 2 * width, 3), np.uint8))
    visible_height = min(height, 480)
    assert row.shape == (visible_height, 3 * min(width, 640), 3)
    assert row[:, 2 * min(width, 640) :].any()


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
        table = table_of_points(
            places, np.zeros_like(places), np.full(len(places), 0.01, np.float32), opacity=0.9, sh_degree=0
        )
        return cloud_in_metres(table, 1.0, np.zeros(3))

    assert own_gaussians(scene(50), shape).sum() == 50
    with pytest.raises(ReconstructionError, match="49 Gaussians lie on the mesh; at least 50 must; the cameras may be"):
        own_gaussians(scene(49), shape)
