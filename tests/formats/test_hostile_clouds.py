"""What a cloud file may claim, and the error that answers it."""

import gzip
import io
import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import zstandard

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.cloud_file import cloud_kind, read_cloud
from dynamictree.formats.gltf.gaussian import EXTENSION, write_gltf_gaussian
from dynamictree.formats.splat.compressed_ply import read_compressed_ply
from dynamictree.formats.splat.ply import property_names, write_gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud
from tests.formats.artists import document_of
from tests.formats.meshes import gltf_bytes, written
from tests.formats.test_cloud_round_trips import make_cloud

ASCII = b"ply\nformat ascii 1.0\n"
XYZ = b"property int x\nproperty int y\nproperty int z\nend_header\n"
HEAD = "ply\nformat binary_little_endian 1.0\n"
NAMES = property_names(1)


def read(content: bytes, file_type: str) -> GaussianCloud:
    return read_cloud(io.BytesIO(content), file_type=file_type)


def cloud_bytes(write: Callable[..., object], count: int = 10) -> bytes:
    cloud = make_cloud(np.random.default_rng(0), count)
    return written(write, replace(cloud, sh=np.zeros_like(cloud.sh)))


def ply(count: int, names: list[str], body: bytes = b"") -> bytes:
    lines = [f"property float {name}" for name in names]
    return (HEAD + f"element vertex {count}\n" + "\n".join(lines) + "\nend_header\n").encode() + body


def spz(
    version: int, count: int, degree: int, *, fractional: int = 12, magic: int = 0x5053474E, body: bytes = b""
) -> bytes:
    return gzip.compress(struct.pack("<IIIBBBB", magic, version, count, degree, fractional, 0, 0) + body, mtime=0)


def spz4(count: int, streams: int, table_offset: int, rest: bytes, *, version: int = 4, degree: int = 0) -> bytes:
    return b"NGSP" + struct.pack("<IIBBBBI12x", version, count, degree, 12, 0, streams, table_offset) + rest


FIVE = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(5))


def changed_glb(change: Callable[[dict[str, object]], None]) -> bytes:
    document = document_of(cloud_bytes(write_gltf_gaussian))
    change(document.root)
    return gltf_bytes(document.root, document.buffers[0])


def _set(document: object, path: str, value: object) -> None:
    *parents, last = [int(key) if key.isdecimal() else key for key in path.split("/")]
    for key in parents:
        document = document[key]
    document[last] = value


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("bufferViews/0/byteLength", 5, "ends at byte 120 of a view of 5"),
        *(("accessors/0/type", shape, "type is .* a string is allowed") for shape in ([], {}, None, 3)),
        ("accessors/2/type", "SCALAR", r"\(10, 1\); \(10, 3\) is needed"),
        ("meshes/0/primitives/0/mode", 4, "not of points"),
        ("meshes/0/primitives/0/extensions", {}, "no primitive with KHR"),
        ("meshes/0/primitives/0/attributes", {"POSITION": 0, f"{EXTENSION}:SH_DEGREE_0_COEF_0": 1}, r"\(10, 4\)"),
        ("meshes/0/primitives/0/attributes", {"POSITION": 77}, "POSITION .* is 77"),
        ("meshes/0/primitives/0/attributes", {"POSITION": 0}, "0 harmonics"),
        ("meshes/0/primitives/0/attributes", {"POSITION": 0, f"{EXTENSION}:SH_DEGREE_0_COEF_0": 0},
         "no attribute KHR_gaussian_splatting:ROTATION"),
        ("meshes/0/primitives/0/attributes", [], "attributes is .*a JSON object"),
        ("nodes/0/scale", [1, 2, 1], "mirrors, shears or stretches"),
        ("scene", 5, "scene .* is 5; a whole number from 0 to 0"),
    ],
)  # fmt: skip
def test_a_contradictory_glb_is_reported_with_the_place(path: str, value: object, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read(changed_glb(lambda document: _set(document, path, value)), "glb")


def test_a_glb_placed_by_its_node_is_read_where_it_stands() -> None:
    matrix = [0, 0, -2, 0, 0, 2, 0, 0, 2, 0, 0, 0, 1, 2, 3, 1]  # columns: a quarter turn about y, twice as large
    moved = read(changed_glb(lambda document: _set(document, "nodes/0/matrix", matrix)), "glb")
    plain = read(cloud_bytes(write_gltf_gaussian), "glb")
    x, y, z = plain.means.T
    np.testing.assert_allclose(moved.means, np.stack([2 * -y + 1, 2 * x - 3, 2 * z + 2], axis=1), atol=1e-5)
    np.testing.assert_allclose(moved.scales, plain.scales * 2, rtol=1e-5)


def test_linear_colours_become_display_colours() -> None:
    space = f"meshes/0/primitives/0/extensions/{EXTENSION}/colorSpace"
    linear = changed_glb(lambda document: _set(document, space, "lin_rec709_display"))
    grey = read(linear, "glb").sh[0, 0, 0] * 0.28209479 + 0.5
    np.testing.assert_allclose(grey, 0.735357, atol=1e-5)  # sRGB of linear 0.5, IEC 61966-2-1


def test_a_glb_of_meshes_is_distinguished_from_splats() -> None:
    content = changed_glb(lambda document: _set(document, "meshes/0/primitives/0/extensions", {}))
    assert cloud_kind(io.BytesIO(content), file_type="glb") == "mesh"
    assert cloud_kind(io.BytesIO(b""), file_type="obj") == "mesh"


def compressed(vertices: int, chunks: int, *, bounds: bool = True) -> bytes:
    names = ("x", "y", "z", "scale_x", "scale_y", "scale_z")
    bounds_names = [f"{side}_{name}" for side in ("min", "max") for name in names] if bounds else ["min_x"]
    header = HEAD + f"element chunk {chunks}\n" + "".join(f"property float {name}\n" for name in bounds_names)
    packed = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
    header += f"element vertex {vertices}\n" + "".join(f"property uint {name}\n" for name in packed) + "end_header\n"
    low_high = np.repeat(np.array([-1.0, 1.0]), 6) * 2
    body = np.tile(low_high.astype("<f4"), chunks).tobytes()
    packed_rows = np.tile(np.array([0xFFFFFFFF, 512 << 20 | 512 << 10 | 512, 0, 0x80FF00FF], "<u4"), vertices)
    return header.encode() + body + packed_rows.tobytes()


def test_a_compressed_ply_is_unpacked() -> None:
    cloud = read_cloud(io.BytesIO(compressed(300, 2)), file_type="ply", up_axis="+Z")
    np.testing.assert_allclose(cloud.means, 2)
    np.testing.assert_allclose(cloud.scales, np.exp(-2), rtol=1e-5)
    np.testing.assert_allclose(cloud.opacity, 1)
    np.testing.assert_allclose(cloud.sh[0, 0] * 0.28209479 + 0.5, [128 / 255, 1, 0], atol=1e-5)
    np.testing.assert_allclose(cloud.quaternions[0], [1, 0, 0, 0], atol=2e-3)


def test_a_compressed_ply_that_lies_and_a_splat_of_a_broken_size_are_refused() -> None:
    for content, kind, message in (
        (compressed(10, 2), "ply", "2 chunks"),
        (compressed(10, 1, bounds=False), "ply", "bounds or packed"),
        (compressed(10, 1)[:-1], "ply", "truncated"),
        (bytes(33), "splat", "33 bytes"),
    ):
        with pytest.raises(FormatError, match=message):
            read(content, kind)
    with pytest.raises(FormatError, match="no compressed splat"):
        read_compressed_ply(io.BytesIO(cloud_bytes(write_gaussian_ply)))


BROKEN = {
    "ply": [
        (ply(1_000, NAMES), r"1,000 rows of 68 bytes in 'vertex', 68,000 bytes, but 0 are left"),
        (ply(50_000_000, NAMES), "50,000,000 Gaussians"),
        (ply(0, NAMES), "empty"),
        (ply(1, [n for n in NAMES if n not in ("rot_3", "opacity")], bytes(60)), "have no opacity, rot_3"),
        (ply(1, [*NAMES, *(f"f_rest_{i + 1}" for i in range(9))], bytes(104)), "9 properties f_rest"),
        (ply(1, NAMES, np.full(17, np.nan, "<f4").tobytes()), "not finite|rotation has a length"),
        (ply(1, NAMES, np.full(17, 100, "<f4").tobytes()), "scales of 1 Gaussians are not finite"),
        (ply(1, NAMES, np.full(17, -20, "<f4").tobytes()), "nothing is visible"),
        (ply(1, NAMES, bytes(68)), "rotation has a length"),
        (b"no ply at all\n", "begin with 'ply'"),
        (b"ply\n" + b"comment " + b"x" * 100_000 + b"\n", "no end within 65,536"),
        (b"ply\nend_header\n", "names no format"),
        (HEAD.encode() + b"element vertex -3\nend_header\n", "not understood: 'element vertex -3'"),
        (HEAD.encode() + b"element vertex 1\nproperty quad x\nend_header\n", "not understood: 'property quad x'"),
        (ply(1, ["x", "x"]), "'x' of 'vertex' twice"),
        (
            (HEAD + "element early 1\nproperty list uchar int i\n").encode() + ply(1, NAMES)[len(HEAD) :],
            "'early' of the PLY file has lists",
        ),
        (ASCII + b"element vertex 9\n" + XYZ + b"1 2 3\n", "9 rows in 'vertex', at least 54 bytes"),
        (ASCII + b"element vertex 1\n" + XYZ + b"1 2 a\n", "what is no number"),
        (ASCII + b"element vertex 2\n" + XYZ + b"1 2 3\n        \n", "2 rows of 3 numbers .* but 3 are left"),
        (ply(3, ["x"]).replace(b"end_h", b"element face 1\nproperty list uchar int i\nend_h"), "it is a mesh"),
    ],
    "splat": [(b"", "empty")],
    "spz": [
        (b"", "neither with 'NGSP' nor as gzip"),
        (spz(3, 4_000_000, 3), "at most 100:1"),
        (spz(3, 50_000_000, 0), "50,000,000 Gaussians"),
        (spz(3, 100, 0), "ends after 0 of 2,000 bytes"),
        (spz(9, 1, 0), "version 9"),
        (spz(3, 1, 0, magic=7), "no SPZ file"),
        (spz(3, 1, 4, body=bytes(100)), "degree 4"),
        (spz(3, 1, 0, fractional=30, body=bytes(20)), "30 fractional bits"),
        (spz(3, 1, 0)[:12], "truncated|within its header"),
        (b"\x1f\x8b\x08\x00" + bytes(60), "damaged|within its header"),
        (spz4(1, 5, 32, b"", version=5), "version 5"),
        (spz4(1, 9, 32, b""), "9 streams at byte 32"),
        (spz4(1, 6, 32, b""), "within its table"),
        (spz4(1, 6, 32, struct.pack("<12Q", *[5, 9] * 6)), "runs past the file's end"),
        (spz4(1, 6, 32, struct.pack("<12Q", *[5, 8] * 6) + bytes(64)), "an SPZ stream is 8 bytes"),
        (spz4(1, 6, 32, struct.pack("<12Q", *[9, 9] * 6) + bytes(64)), "damaged"),
        (spz4(1, 6, 32, struct.pack("<12Q", len(FIVE), 9, *[0, 0] * 5) + FIVE), "ends after 5 of 9"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "content", "message"), [(kind, *row) for kind, rows in BROKEN.items() for row in rows]
)
def test_a_contradictory_file_is_reported_with_the_place(kind: str, content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(content, kind)


def test_types_axes_and_units_that_do_not_exist_are_refused() -> None:
    with pytest.raises(FormatError, match=r"no cloud is read from \.obj"):
        read(b"", "obj")
    content = cloud_bytes(write_gaussian_ply)
    with pytest.raises(InputError, match="up_axis"):
        read_cloud(io.BytesIO(content), file_type="ply", up_axis="Y")
    for unit_m in (0.0, -1.0, float("inf")):
        with pytest.raises(InputError, match="unit_m"):
            read_cloud(io.BytesIO(content), file_type="ply", unit_m=unit_m)
