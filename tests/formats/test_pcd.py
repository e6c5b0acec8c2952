"""Point clouds of the Point Cloud Library."""

import io

import numpy as np
import pytest

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.cloud_file import cloud_kind, read_cloud
from dynamictree.formats.source_file import source_kind
from dynamictree.gaussian.harmonics import SH_0

POINTS = np.random.default_rng(0).uniform(0, 2, (50, 3)).astype(np.float32)
COLORS = np.random.default_rng(1).integers(0, 256, (50, 3)).astype(np.uint32)


def pcd(coding: str, *, padded: bool = False, size: int = 4) -> bytes:
    packed = COLORS @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    fields = ["x", "y", "z", *(["_"] if padded else []), "rgb"]
    counts = [1, 1, 1, *([size] if padded else []), 1]
    kinds = ["F", "F", "F", *(["U"] if padded else []), "F"]
    sizes = [4, 4, 4, *([1] if padded else []), 4]
    entries = {"VERSION": ["0.7"], "FIELDS": fields, "SIZE": sizes, "TYPE": kinds, "COUNT": counts, "WIDTH": [50]}
    entries |= {"HEIGHT": [1], "VIEWPOINT": [0, 0, 0, 1, 0, 0, 0], "POINTS": [50], "DATA": [coding]}
    lines = ["# .PCD v0.7 - Point Cloud Data file format"]
    lines += [f"{name} {' '.join(map(str, values))}" for name, values in entries.items()]
    head = "\n".join(lines).encode() + b"\n"
    if coding == "ascii":
        rows = [
            " ".join([*(repr(float(v)) for v in point), *(["7"] * size if padded else []), repr(float(color))])
            for point, color in zip(POINTS, packed.view(np.float32), strict=True)
        ]
        return head + "\n".join(rows).encode() + b"\n"
    kind = [("p", "<f4", 3), *([("_", "u1", size)] if padded else []), ("rgb", "<u4")]
    table = np.zeros(50, kind)
    table["p"], table["rgb"] = POINTS, packed
    return head + table.tobytes()


@pytest.mark.parametrize("padded", [False, True])
@pytest.mark.parametrize("coding", ["ascii", "binary"])
def test_points_and_colours_are_read(coding: str, padded: bool) -> None:
    stream = io.BytesIO(pcd(coding, padded=padded))
    assert source_kind(stream, "scan.pcd") == ("cloud", "pcd")
    assert cloud_kind(stream, file_type="pcd") == "points"
    cloud = read_cloud(stream, file_type="pcd")
    np.testing.assert_allclose(cloud.means, POINTS, atol=1e-6)
    np.testing.assert_allclose(cloud.sh[:, 0] * SH_0 + 0.5, COLORS / 255, atol=1e-5)


def test_places_where_nothing_was_measured_are_left_out() -> None:
    content = bytearray(pcd("binary"))
    content[-16:-12] = np.float32(np.nan).tobytes()
    assert read_cloud(io.BytesIO(bytes(content)), file_type="pcd").num_gaussians == 49


@pytest.mark.parametrize(
    ("content", "advice"),
    [
        (pcd("binary_compressed"), "pcl_convert_pcd_ascii_binary"),
        (pcd("binary")[:-1], "truncated"),
        (pcd("ascii")[:-40], "truncated"),
        (pcd("ascii").replace(b"FIELDS x y z", b"FIELDS a b c"), "x, y and z are needed"),
        (pcd("ascii").replace(b"SIZE 4 4", b"SIZE 4"), "damaged"),
        (pcd("binary").replace(b"SIZE 4", b"SIZE 3"), "of a size"),
        (pcd("ascii").replace(b"DATA ascii\n", b"DATA ascii\nx "), "what is no number"),
        (pcd("ascii").replace(b"DATA ascii", b"# no data"), "no line DATA"),
        (pcd("ascii").replace(b"POINTS 50", b"POINTS 51"), "truncated"),
    ],
)
def test_damaged_files_are_refused(content: bytes, advice: str) -> None:
    with pytest.raises(FormatError, match=advice):
        read_cloud(io.BytesIO(content), file_type="pcd")


def test_too_many_points_are_refused_before_memory_is_taken() -> None:
    with pytest.raises(InputError, match="at most"):
        read_cloud(io.BytesIO(pcd("binary").replace(b"POINTS 50", b"POINTS 50000000000")), file_type="pcd")


def test_a_colour_of_several_numbers_is_none() -> None:
    content = pcd("binary", padded=True, size=3).replace(b"FIELDS x y z _ rgb", b"FIELDS x y z rgb _")
    with_colors = read_cloud(io.BytesIO(content), file_type="pcd")
    without = read_cloud(io.BytesIO(content.replace(b"z rgb _", b"z rg_ __")), file_type="pcd")
    np.testing.assert_array_equal(with_colors.sh, without.sh)
