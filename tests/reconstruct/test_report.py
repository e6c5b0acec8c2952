"""What the report says of a reconstruction."""

import numpy as np
import pytest

from dynamictree.reconstruct.report import comparison_row, quality_warnings


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
