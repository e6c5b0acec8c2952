"""A splat has a free scale: it is made as tall as stated, or 5 m with a warning; a scan is in metres."""

import io

import numpy as np
import pytest

from dynamictree.formats.source_file import read_capture
from dynamictree.plant.axes_unit import DEFAULT_HEIGHT_M, cloud_height
from dynamictree.requests import Reading


def splat_bytes(height: float) -> bytes:
    """A `.splat` of 600 Gaussians, +Y up in its file."""
    rng = np.random.default_rng(0)
    rows = np.zeros(600, [("place", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])
    rows["place"] = rng.uniform(0, 1, (600, 3)) * [0.3, height, 0.3]
    rows["scale"], rows["rgba"], rows["turn"] = 0.01 * height, 255, (255, 128, 128, 128)
    return rows.tobytes()


def test_a_splat_of_unknown_size_is_five_metres_tall_and_doubted() -> None:
    result = read_capture(io.BytesIO(splat_bytes(1.7)), file_type="splat", reading=Reading(up_axis="+Y"))
    assert cloud_height(result.cloud) == pytest.approx(DEFAULT_HEIGHT_M, rel=1e-4)
    assert [(warning.code, "box_m" in warning.message) for warning in result.warnings] == [("size-unknown", True)]


def test_a_stated_height_or_unit_is_taken() -> None:
    tall = read_capture(io.BytesIO(splat_bytes(1.7)), file_type="splat", reading=Reading(up_axis="+Y", height_m=12.0))
    assert (cloud_height(tall.cloud), tall.warnings) == (pytest.approx(12.0, rel=1e-4), ())
    metres = read_capture(io.BytesIO(splat_bytes(1.7)), file_type="splat", reading=Reading(up_axis="+Y", unit_m=1.0))
    assert (metres.cloud.source.scale, metres.warnings) == (1.0, ())
    larger = tall.cloud.source.scale / metres.cloud.source.scale
    np.testing.assert_allclose(tall.cloud.scales / metres.cloud.scales, larger, rtol=1e-5)


def test_a_scan_keeps_its_metres() -> None:
    lines = b"".join(b"%f 0 %f\n" % (0.01 * i, 0.01 * i) for i in range(600))
    result = read_capture(io.BytesIO(lines), file_type="txt")
    assert result.cloud.source.scale == 1.0
    assert result.warnings == ()


def test_a_wood_from_the_air_that_shows_no_stems_is_doubted() -> None:
    places = np.random.default_rng(0).uniform(0, 1, (20_000, 3)) * [80, 80, 25]  # as lidR's MixedConifer.laz
    result = read_capture(io.BytesIO("\n".join(f"{x} {y} {z}" for x, y, z in places).encode()), file_type="txt")
    assert [warning.code for warning in result.warnings] == ["size-doubtful"]
