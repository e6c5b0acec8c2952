"""Scans become Gaussians as wide as their points are apart."""

import io
import re
from dataclasses import replace

import laspy
import numpy as np
import pytest

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.cloud_file import cloud_kind, read_cloud
from dynamictree.formats.scan.points import Scan, cloud_of_points
from dynamictree.formats.source_file import read_capture
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.plant.plausibility import doubt_cloud
from dynamictree.up_axis import up_rotation

Keys = tuple[tuple[int, int], ...]
"""GeoTIFF keys and their values."""


def _lattice(spacing: float, count: int = 8) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(count) * spacing] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def las_of(points: np.ndarray, colors: np.ndarray | None = None, *, packed: bool = False) -> io.BytesIO:
    header = laspy.LasHeader(point_format=3 if colors is not None else 0, version="1.2")
    header.offsets, header.scales = np.floor(points.min(axis=0)), np.full(3, 0.001)
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    if colors is not None:
        las.red, las.green, las.blue = (colors * 257).T
    return _stream(las, packed=packed)


def _las_1_4() -> laspy.LasData:
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.x, las.y, las.z = _lattice(0.2).T
    return las


def _las_with_system(wkt: str, keys: Keys) -> io.BytesIO:
    las = laspy.read(las_of(_lattice(0.2)))
    values = [1, 1, 0, len(keys), *(number for name, value in keys for number in (name, 0, 1, value))]
    record = (2112, wkt.encode() + b"\0") if wkt else (34735, np.array(values, "<u2").tobytes())
    las.header.vlrs.append(laspy.VLR("LASF_Projection", record[0], "", record[1]))
    return _stream(las)


def _stream(las: laspy.LasData, *, packed: bool = False) -> io.BytesIO:
    stream = io.BytesIO()
    las.write(stream, do_compress=packed)
    stream.seek(0)
    return stream


def test_a_gaussian_is_half_as_wide_as_its_neighbours_are_far() -> None:
    stray, at_one_place = [[100.0, 0.0, 0.0]], np.zeros((5, 3))
    scales = cloud_of_points(Scan(points=np.concatenate([_lattice(0.2), stray, at_one_place]))).scales
    np.testing.assert_allclose(scales[1:512], 0.1, rtol=1e-5)
    assert scales[512].max() < 0.5
    assert scales.min() > 0


@pytest.mark.parametrize("packed", [False, True])
def test_las_and_laz_keep_positions_and_colours(rng, packed: bool) -> None:
    points = _lattice(0.2) + np.array([500_000, 5_300_000, 400])  # as surveys: float32 alone would round to 0.5 m
    colors = rng.integers(0, 256, (len(points), 3))
    stream = las_of(points, colors, packed=packed)
    assert cloud_kind(stream, file_type="laz") == "points"
    cloud = read_cloud(stream, file_type="laz" if packed else "las")
    np.testing.assert_allclose(cloud.means, points - cloud.source.offset, atol=1e-3)
    np.testing.assert_allclose(cloud.sh[:, 0] * SH_0 + 0.5, colors / 255, atol=1e-6)


FOOT = 'UNIT["US survey foot",0.304800609601219]'
WKT = 'PROJCS["NAD83",GEOGCS["NAD83",DATUM["D",SPHEROID["GRS",6378137,298.25]],UNIT["degree",0.0174532925199433]],'


@pytest.mark.parametrize(
    ("wkt", "keys", "metres"),
    [
        (WKT + FOOT + "]", (), (0.3048006, 0.3048006)),
        (f'COMPD_CS["a",{WKT}{FOOT}],VERT_CS["NAVD88",UNIT["metre",1]]]', (), (0.3048006, 1.0)),
        ('PROJCRS["a",BASEGEOGCRS["b",DATUM["c",ELLIPSOID["d",6378137,298,LENGTHUNIT["metre",1]]]],CS[Cartesian,2],'
         'AXIS["e",east],LENGTHUNIT["foot",0.3048]]', (), (0.3048, 0.3048)),
        (WKT + 'UNIT["metre",1]]', (), (1.0, 1.0)),
        ("", ((1024, 1), (3076, 9002)), (0.3048, 0.3048)),
        ("", ((1024, 1), (3076, 9003), (4099, 9001)), (0.3048006, 1.0)),
        ("", ((1024, 1), (3072, 32632)), (1.0, 1.0)),
        ("", ((3072, 2263),), (1200 / 3937, 1200 / 3937)),  # New York, US survey feet
        ("", ((3072, 2263), (4096, 5703)), (1200 / 3937, 1.0)),  # NAVD88 height in metres
        ("", ((3072, 32767),), (1.0, 1.0)),  # defined by the user
        ("", ((3072, 31000),), (1.0, 1.0)),  # no coordinate system
    ],
)  # fmt: skip
def test_the_coordinate_system_says_the_unit(wkt: str, keys: Keys, metres: tuple[float, float]) -> None:
    if (3072, 2263) in keys:
        pytest.importorskip("pyproj")
    stream = _las_with_system(wkt, keys)
    capture = read_capture(stream, file_type="las")
    np.testing.assert_allclose(np.ptp(capture.cloud.means, axis=0), 1.4 * np.array(metres)[[0, 0, 1]], rtol=1e-4)
    assert ("unit-of-the-file" in [warning.code for warning in capture.warnings]) == (metres[0] != 1)
    stream.seek(0)
    assert read_cloud(stream, file_type="las", unit_m=2.0).source.scale == 2


@pytest.mark.parametrize(
    ("wkt", "keys"), [('GEOGCS["WGS 84",UNIT["degree",0.0174]]', ()), ("", ((1024, 2),)), ("", ((2048, 4326),))]
)
def test_scans_in_degrees_are_refused_with_advice(wkt: str, keys: Keys) -> None:
    if (2048, 4326) in keys:
        pytest.importorskip("pyproj")
    with pytest.raises(InputError, match="degrees of longitude and latitude; project them"):
        read_cloud(_las_with_system(wkt, keys), file_type="las")


def test_noise_and_withheld_points_are_left_out() -> None:
    las = _las_1_4()
    las.classification[:3], las.withheld[5] = [7, 18, 4], 1
    cloud = read_cloud(_stream(las), file_type="las")
    assert (cloud.num_gaussians, cloud.dropped) == (512 - 3, 3)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_a_ply_without_faces_is_a_point_cloud(encoding: str) -> None:
    points = _lattice(0.5, 3)
    layout = [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    rows = np.zeros(27, layout)
    rows["x"], rows["y"], rows["z"] = points.T
    rows["green"] = 255
    header = [f"ply\nformat {encoding} 1.0\nelement vertex 27"]
    header += [f"property {'uchar' if kind == 'u1' else 'double'} {name}" for name, kind in layout]
    header += ["element face 0\nproperty list uchar int vertex_indices\nend_header\n"]
    body = "\n".join(" ".join(str(v) for v in row) for row in rows).encode() if encoding == "ascii" else rows.tobytes()
    stream = io.BytesIO("\n".join(header).encode() + body)
    assert cloud_kind(stream, file_type="ply") == "points"
    cloud = read_cloud(stream, file_type="ply")
    np.testing.assert_allclose(cloud.means, points, atol=1e-6)
    np.testing.assert_allclose(cloud.sh[0, 0] * SH_0 + 0.5, [0, 1, 0], atol=1e-6)


GAUSSIANS = "x,y,z,scale_0,scale_1,scale_2,f_dc_0,f_dc_1,f_dc_2,opacity,rot_0,rot_1,rot_2,rot_3"


@pytest.mark.parametrize(
    ("content", "kind", "message"),
    [
        ("# nothing\n", "txt", "empty"),
        ("1 2\n3 4\n", "txt", "2 numbers"),
        ("1 2 3\n3 4 abc\n", "txt", "no table"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nend_header\n1\n", "ply", "x, y and z"),
        ("branch,radius,length,start_x,start_y,start_z\n" + "1,2,3,4,5,6\n" * 4, "csv",
         "columns are branch, radius, length, startx, starty, startz"),
        ("\n".join([GAUSSIANS, ",".join(["0.5"] * 14)]), "csv", r"Gaussians.*splat-transform tree\.csv tree\.ply"),
        ("1 1 1\n" * 10, "txt", "at one place"),
        ("LASF", "las", "truncated"),
        ("nothing of the kind" * 100, "las", "no LAS file"),
    ],
)  # fmt: skip
def test_what_is_no_cloud_is_refused(content: str, kind: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_cloud(io.BytesIO(content.encode()), file_type=kind)


def test_a_text_larger_than_any_cloud_is_refused_unread(monkeypatch) -> None:
    monkeypatch.setattr("dynamictree.formats.scan.text.MAX_GAUSSIANS", 1)
    with pytest.raises(InputError, match="at most 1 points"):
        read_cloud(io.BytesIO(b"1 2 3\n" * 100), file_type="txt")


@pytest.mark.parametrize(
    ("packed", "at", "declared", "message"),
    [
        (False, 96, b"\xff\xff\xff\x7f", "points begin at byte 2,147,483,647"),
        (False, 100, b"\xff\xff\xff\xff", "4,294,967,295 records"),  # laspy would read each of them
        (True, -1, b"\xff\xff\xff\x7f", "2,147,483,647 chunks"),  # lazrs would make room for them, and abort
        (True, -2, b"\xff\xff\xff\x7f", "chunks of the LAZ file are listed at byte"),
    ],
)
def test_a_las_header_may_not_claim_what_the_file_has_no_room_for(
    packed: bool, at: int, declared: bytes, message: str
) -> None:
    content = bytearray(las_of(_lattice(0.2), packed=packed).getvalue())
    points_at = int.from_bytes(content[96:100], "little")
    at = {-1: int.from_bytes(content[points_at : points_at + 8], "little") + 4, -2: points_at}.get(at, at)
    content[at : at + len(declared)] = declared
    with pytest.raises(FormatError, match=message):
        read_cloud(io.BytesIO(bytes(content)), file_type="las")


def test_a_las_header_that_ends_within_itself_or_claims_extended_records_is_refused() -> None:
    content = bytearray(_stream(_las_1_4()).getvalue())
    content[243:247] = b"\xff\xff\xff\x0f"
    with pytest.raises(FormatError, match="268,435,455 extended records"):
        read_cloud(io.BytesIO(bytes(content)), file_type="las")
    content = bytearray(las_of(_lattice(0.2)).getvalue()[:240])
    content[25] = 3  # version 1.3, whose header is longer
    content[94:104] = (235).to_bytes(2, "little") + (240).to_bytes(4, "little") + bytes(4)
    for size in (228, 232, 240):
        content[96:100] = size.to_bytes(4, "little")
        with pytest.raises(InputError):
            read_cloud(io.BytesIO(bytes(content[:size])), file_type="las")


@pytest.mark.parametrize(
    "text",
    [
        'id;"Z (m)";"X (m)";"Y (m)";intensity;R;G;B\n1;9;1;2;7;200;0;0\n2;8;3;4;7;0;200;0\n3;7;5;6;7;0;0;200\n',
        *(head + "\n1 2 9\n3 4 8\n5 6 7".replace(" ", re.sub(r"\w", "", head)[0])
          for head in ("Easting,Northing,Elevation", "Rechtswert;Hochwert;Höhe", "X_coord\tY_coord\tZ_coord")),
    ],
)  # fmt: skip
def test_columns_of_text_are_found_by_their_names(text: str) -> None:
    cloud = read_cloud(io.BytesIO(text.encode()), file_type="csv")
    np.testing.assert_allclose(cloud.means, [[1, 2, 9], [3, 4, 8], [5, 6, 7]])
    assert "R;G;B" not in text or np.argmax(cloud.sh[:, 0], axis=1).tolist() == [0, 1, 2]


@pytest.mark.parametrize(("count", "height", "doubted"), [(400, 5.0, True), (2000, 0.3, True), (2000, 5.0, False)])
def test_what_does_not_look_like_a_plant_is_doubted(count: int, height: float, doubted: bool, rng) -> None:
    lines = rng.uniform([-1, -1, 0], [1, 1, height], size=(count, 3))
    warnings = doubt_cloud(cloud_of_points(Scan(points=lines)))
    assert ("not-like-a-plant" in [warning.code for warning in warnings]) == doubted


def test_specks_far_from_each_other_are_doubted(rng) -> None:
    solid = cloud_of_points(Scan(points=rng.uniform([-1, -1, 0], [1, 1, 2], size=(2000, 3))))
    specks = replace(solid, scales=solid.scales / 20)
    assert [warning.code for warning in doubt_cloud(specks)] == ["not-like-a-plant"]
    along = np.stack([np.zeros(2000), np.zeros(2000), np.linspace(0, 5, 2000)], axis=1)
    stem = cloud_of_points(Scan(points=along + rng.normal(0, 0.01, along.shape)))
    assert doubt_cloud(replace(stem, scales=stem.scales / 20)) == ()  # small, but they hang together


@pytest.mark.parametrize("up_axis", ["+Z", "-Y"])
def test_points_without_colour_are_lit_from_above(up_axis: str, rng) -> None:
    ball = rng.uniform(-1, 1, size=(40_000, 3))
    ball = ball[np.linalg.norm(ball, axis=1) < 1][:20_000]  # a crown
    cloud = cloud_of_points(Scan(points=ball), up_axis=up_axis)
    light = (cloud.sh[:, 0] * SH_0 + 0.5).mean(axis=1)
    height = (ball @ up_rotation(up_axis).T)[:, 2]
    outer = np.linalg.norm(ball, axis=1) > 0.9
    assert light[outer & (height > 0.5)].mean() > 1.3 * light[outer & (height < -0.5)].mean()
    assert light[outer & (height > 0.5)].mean() > 1.1 * light[~outer & (height < 0)].mean()
    colored = cloud_of_points(Scan(points=ball, colors=np.full((20_000, 3), 90, np.uint8)))
    np.testing.assert_allclose(colored.sh[:, 0] * SH_0 + 0.5, 90 / 255, atol=1e-5)


def test_the_number_of_points_before_a_scan_is_no_point() -> None:
    rows = np.concatenate([_lattice(0.5, 3), np.full((27, 1), -1024), np.tile([10, 20, 30], (27, 1))], axis=1)
    block = "27\n" + "\n".join(" ".join(f"{value:g}" for value in row) for row in rows) + "\n"
    cloud = read_cloud(io.BytesIO((block + block).encode()), file_type="pts")
    np.testing.assert_allclose(cloud.means, np.tile(_lattice(0.5, 3), (2, 1)), atol=1e-6)
    np.testing.assert_allclose(cloud.sh[0, 0] * SH_0 + 0.5, np.array([10, 20, 30]) / 255, atol=1e-5)


@pytest.mark.parametrize("delimiter", [";", "; ", "\t", " "])
def test_decimal_commas_are_read(delimiter: str) -> None:
    lines = [delimiter.join(f"{value:.2f}".replace(".", ",") for value in row) for row in _lattice(-0.25, 3)]
    cloud = read_cloud(io.BytesIO("\n".join(["X;Y;Z".replace(";", delimiter), *lines]).encode()), file_type="txt")
    np.testing.assert_allclose(cloud.means, _lattice(-0.25, 3), atol=1e-6)
