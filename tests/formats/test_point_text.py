"""Tables of points as many programs write them, PCD among them; the reports named are of other projects' users."""

import io

import numpy as np
import pytest

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.cloud_file import cloud_kind, read_cloud
from dynamictree.formats.mesh_file import sniff_file_type
from dynamictree.formats.source_file import source_kind
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0

PLACES = np.array([[0.5, 1.25, 0.25], [0.75, 1.5, 2.5], [1.0, 1.75, 4.5], [0.25, 1.0, 5.75]])
BROWN = [117, 73, 49]


def cloud_of(text: str, kind: str = "xyz") -> GaussianCloud:
    return read_cloud(io.BytesIO(text.encode()), file_type=kind)


def table(behind: str = "", *, head: str = "", delimiter: str = " ") -> str:
    rows = [" ".join([*(f"{value:.6f}" for value in place), *behind.split()]) for place in PLACES.tolist()]
    return head + "\n".join(row.replace(" ", delimiter) for row in rows) + "\n"


def rgb(cloud: GaussianCloud) -> list[int]:
    mean: list[int] = np.rint((cloud.sh[:, 0] * SH_0 + 0.5).mean(axis=0) * 255).astype(int).tolist()
    return mean


@pytest.mark.parametrize(
    "text",
    [
        table("117 73 49"),
        table("117 73 49 255"),  # x y z r g b a: trimesh's tests
        table("117 73 49 0.1 -0.7 0.7", head="//X Y Z R G B Nx Ny Nz\n"),  # CloudCompare
        table("117 73 49 1800 4", head="//X Y Z R G B Intensity Classification\n"),
        table("0.458824 0.286275 0.192157 0.514534 0 0.889831", head="//X;Y;Z;Rf;Gf;Bf;Intensity;curvature;PCV\n4\n",
              delimiter=";"),  # PDAL 1508
        table("0.458824 0.286275 0.192157"),
        table("55 117 73 49", head="4\n"),  # PTS: paulbourke.net/dataformats/pts
        table("-1024 117 73 49", head="4 \n"),
        table("0.4321 117 73 49"),  # PTS without its count, intensity a share: Open3D 913
        table("-0.594618 0.371081 -0.713251 117 73 49"),  # PoissonRecon 141
        table("117 73 49 -0.594618 0.371081 -0.713251"),  # Metashape
        table("30000 117 73 49 2"),
        table("117 73 49 2 12"),  # a class and a tree
        table("30069 18761 12593"),  # 16 bits
        table("117 73 49", head='"X","Y","Z","Red","Green","Blue"\n', delimiter=","),
        table("117 73 49", head="\ufeffx|y|z|red|green|blue\n", delimiter="|"),
        table("9 117 73 49 0", head="X Y Z Intensity R G B ReturnNumber\n"),  # lidR
        table("117 73 49 7", head="; exported\n; x y z r g b scan\n"),
        table("117 73 49", head='"x" "y" "z" "r" "g" "b"\n').replace("\n", '\n"1" ')[:-5],  # R: write.table
        ('"' + table("117 73 49", head="x y z r g b\n").replace(" ", '" "').replace("\n", '"\n"'))[:-1],
        table("49 73 117", head="# x [m], y [m], z [m], blue, green, red\n"),
        table("117 73 49", head="FARO Scan 012\nsome words that are no names\nX\tY\tZ\tR\tG\tB\n", delimiter="\t"),
        table("117 73 49") + "0 0 0 12 13 14\n0 0 0 9 9 9\n",  # where a scanner saw nothing: PclCSharp 6
        table("117 73 49") + "nan nan nan 12 13 14\n",
        table("117.0 73.0 49.0", head="% MATLAB\n", delimiter="  "),
    ],
)  # fmt: skip
def test_places_and_colours_are_read(text: str) -> None:
    assert sniff_file_type(text.encode(), "tree.xyz") == "points"
    cloud = cloud_of(text)
    np.testing.assert_allclose(cloud.means, PLACES, atol=1e-5)
    assert rgb(cloud) == BROWN


@pytest.mark.parametrize(
    "text",
    [
        table(),
        table("3"),  # TreeQSM, 3DForest: a tree's or a segment's number
        table("3 1"),
        table("3 1 2"),  # class, tree, return
        table("812 3 0", head="X,Y,Z,treeID,class,return\n", delimiter=","),  # FOR-instance
        table("0.6 0.0 0.8"),  # normals that are not negative
        table("0.1 -0.7 0.7"),
        table("0.1 -0.7 0.7 4"),  # ShapeNet's parts
        table("513.25 2 1 30512"),  # intensity, returns, time
        table("0 0 0", head="X Y Z R G B\n"),  # colours that nobody set
        table("65535 1 12 3 117 0 1", head="X Y Z Intensity ReturnNumber NumberOfReturns Classification Source a b\n"),
        table("128", head="//X Y Z Grey\n"),  # CloudCompare 959
    ],
)
def test_labels_normals_and_intensities_are_no_colours(text: str) -> None:
    cloud = cloud_of(text)
    np.testing.assert_allclose(cloud.means, PLACES, atol=1e-5)
    red, green, blue = rgb(cloud)
    assert blue < red < green  # the grey of shaded points


def test_map_coordinates_with_commas_keep_their_millimetres() -> None:
    lines = (f"{x + 694386:.3f},{y + 5155487:.3f},{z + 381:.3f}" for x, y, z in PLACES.tolist())  # Open3D 1379
    cloud = cloud_of("\n".join(lines), "txt")
    moved = np.subtract(cloud.source.offset, (694386, 5155487, 381))
    np.testing.assert_allclose(cloud.means + moved, PLACES, atol=1e-3)


def test_positions_beyond_single_precision_are_refused() -> None:
    with pytest.raises(InputError, match="beyond 3e38"):
        cloud_of(table() + "1e200 0 0\n")


def test_rows_that_are_left_out_are_counted() -> None:
    assert cloud_of(table() + "nan 1 2\n1 inf 2\n").dropped == 2


@pytest.mark.parametrize("shift", [(8.4, 47.3), (-122.4, 37.7)])
def test_degrees_are_refused_with_advice(shift: tuple[float, float]) -> None:
    places = np.column_stack([PLACES[:, :2] * 1e-5 + shift, PLACES[:, 2]])
    with pytest.raises(InputError, match=r"degrees of longitude and latitude; project them to metres"):
        cloud_of("\n".join(f"{x:.9f} {y:.9f} {z:.3f}" for x, y, z in places.tolist()))


@pytest.mark.parametrize("text", ["1 2 3\n4 5\n6 7 8\n", "x y z\n1 2 3\n1 2 z\n", "1 2 3 4\n\n5 6 7\n"])
def test_lines_of_different_lengths_are_refused_with_a_line(text: str) -> None:
    with pytest.raises(FormatError, match="no table of numbers: a line is"):
        cloud_of(text)


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
