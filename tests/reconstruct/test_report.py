"""What the report says of a reconstruction."""

import numpy as np
import pytest

from dynamictree.errors import ReconstructionError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.reconstruction import own_gaussians
from dynamictree.reconstruct.report import comparison_row, quality_warnings
from dynamictree.reconstruct.splat_table import cloud_of, table_of_points
from tests.reconstruct.finished import tube


def test_a_splat_hardly_better_than_one_colour_is_warned_of():
    (warning,) = quality_warnings([14.0, 15.8], [12.0, 12.0])
    assert "14.9 dB, a picture of one colour has 12.0 dB" in warning
    assert quality_warnings([14.0, 16.2], [12.0, 12.0]) == []


def test_photo_splat_and_mesh_are_shown_at_one_size(orbit):
    row = comparison_row(
        orbit.stump, _gaussians_at(orbit.stump.vertices), orbit.cameras[0], np.zeros((900, 1200, 3), np.uint8)
    )
    assert row.shape == (480, 3 * 640, 3)
    assert row[:, 640:1280].any()
    assert row[:, 1280:].any()


def _gaussians_at(places: np.ndarray) -> GaussianCloud:
    sizes = np.full(len(places), 0.01, np.float32)
    return cloud_of(table_of_points(places, np.ones_like(places), sizes, opacity=0.9, sh_degree=0))


def test_wrong_cameras_are_named_where_next_to_nothing_lies_on_the_mesh() -> None:
    points, faces = tube(0.1, 0.0, 1.0)
    mesh = TriangleMesh(vertices=points.astype(np.float32), faces=faces.astype(np.int32))

    def scene(number: int) -> GaussianCloud:
        places = np.concatenate([mesh.vertices[:number], np.float32([[5, 5, 5]] * 100)])
        return _gaussians_at(places)

    assert own_gaussians(scene(50), mesh).sum() == 50
    with pytest.raises(ReconstructionError, match="49 Gaussians lie on the mesh; at least 50 must; the cameras may be"):
        own_gaussians(scene(49), mesh)
