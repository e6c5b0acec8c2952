"""What is no mesh, or one that the method cannot work on, is refused with what was found and what is allowed."""

import io

import numpy as np
import pytest

from dynamictree.errors import FormatError, InputError, MeshError
from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.mesh import obj as obj_module
from dynamictree.formats.mesh import ply as ply_module
from dynamictree.formats.mesh import stl as stl_module
from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.mesh_file import MESH_TYPES, sniff_file_type
from dynamictree.formats.suffixes import CLOUD_SUFFIXES, FILM_SUFFIXES, MESH_SUFFIXES, PHOTO_SUFFIXES
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats.meshes import gltf_bytes, image_bytes, read, triangle_gltf, trunk_and_crown, written


def mesh_bytes(mesh: TriangleMesh, file_type: str) -> bytes:
    return written({"glb": write_glb, "ply": write_ply, "obj": write_obj}[file_type], mesh)


def stl(triangles: list[list[list[float]]], count: int | None = None) -> bytes:
    record = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = np.reshape(triangles, (-1, 3, 3))
    return b"\0" * 80 + (len(triangles) if count is None else count).to_bytes(4, "little") + record.tobytes()


def ply(vertices: str, faces: str, *, num_vertices: int = 3, num_faces: int = 1, kind: str = "uchar int") -> bytes:
    return (
        f"ply\nformat ascii 1.0\nelement vertex {num_vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {num_faces}\nproperty list {kind} vertex_indices\nend_header\n{vertices}{faces}"
    ).encode()


def binary_ply(kind: str, body: bytes) -> bytes:
    head = ply("", "", kind=kind, num_faces=2).replace(b"ascii", b"binary_little_endian")
    return head + triangle_gltf()[1][:36] + body


TRIANGLE = "0 0 0\n1 0 0\n0 0 1\n"


@pytest.mark.parametrize("file_type", MESH_TYPES)
@pytest.mark.parametrize("content", [b"", b"hello world\n" * 40, bytes(range(256)) * 4, image_bytes("JPEG")])
def test_what_is_no_mesh_is_refused(file_type: str, content: bytes) -> None:
    with pytest.raises(InputError):
        read(content, file_type)


@pytest.mark.parametrize(("bad", "message"), [(np.nan, "not finite"), (np.inf, "not finite"), (0, "one point")])
def test_a_glb_whose_vertices_are_no_places_or_one_is_refused(bad: float, message: str) -> None:
    root, binary = triangle_gltf()
    with pytest.raises(MeshError, match=message):
        read(gltf_bytes(root, np.full(9, bad, "<f4").tobytes() + binary[36:]), "glb")


@pytest.mark.parametrize("file_type", ["glb", "ply"])
def test_a_truncated_file_is_refused_wherever_it_ends(rng, file_type: str) -> None:
    content = mesh_bytes(trunk_and_crown(rng), file_type)
    for length in np.linspace(0, len(content) - 5, 30).astype(int):
        with pytest.raises(InputError):
            read(content[:length], file_type)


@pytest.mark.parametrize(
    ("module", "content", "file_type"),
    [
        (obj_module, b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + 4 * b"f 1 2 3\n", "obj"),
        (stl_module, b"solid t\n" + 4 * b"facet\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n", "stl"),
        (ply_module, ply(TRIANGLE, "6 0 1 2 0 1 2\n"), "ply"),
    ],
)
def test_too_many_faces_are_refused(monkeypatch, module: object, content: bytes, file_type: str) -> None:
    monkeypatch.setattr(module, "MAX_FACES", 3)
    with pytest.raises(MeshError, match=r"3 triangles|4 triangles|at most 3"):
        read(content, file_type)


def test_ten_million_faces_are_refused_by_the_header_alone() -> None:
    with pytest.raises(MeshError, match="10,000,000"):
        read(stl([], 10_000_000), "stl")
    with pytest.raises(MeshError, match="10,000,000"):
        read(ply(TRIANGLE, "3 0 1 2\n", num_faces=10_000_000), "ply")
    root, binary = triangle_gltf()
    root["accessors"] = [
        {"componentType": 5126, "count": 3, "type": "VEC3"},
        {"componentType": 5125, "count": 12_000_003, "type": "SCALAR"},  # without a view: zeros, at no cost of bytes
    ]
    with pytest.raises(InputError, match="12000003"):
        read(gltf_bytes(root, binary), "glb")


def test_a_texture_that_is_damaged_or_has_too_many_pixels_is_refused(rng, monkeypatch) -> None:
    stream = io.BytesIO()
    companions = write_obj(trunk_and_crown(rng), stream, library="tree.mtl")
    texture = image_bytes(size=(64, 64))
    for changed, message in (({"tree_1.png": b"no image"}, "no image of"), ({"tree_1.png": texture[:60]}, "damaged")):
        with pytest.raises(FormatError, match=message):
            read(stream.getvalue(), "obj", companions=companions | changed)
    monkeypatch.setattr("dynamictree.formats.texture.MAX_PIXELS", 15)
    with pytest.raises(FormatError, match="4 x 4 pixels"):
        read(stream.getvalue(), "obj", companions=companions)


def test_an_obj_with_too_many_texture_seams_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(obj_module, "MAX_VERTICES", 4)
    seams = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/2 2/2 3/2\n"
    with pytest.raises(MeshError, match="needs 6 vertices"):
        read(seams, "obj")


BROKEN = {
    "obj": [
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "no faces"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "corner 4/0/0, but there are 3 vertices"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 -2 -1\n", "corner -4/"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf a b c\n", "b'a/0/0 b/0/0 c/0/0 ', which is not understood"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/1 3/1\n", "0 texture coordinates to choose"),
        (b"v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n", "`v` line of the OBJ file is b'1 0'; 3 numbers"),
        (b"v 0 0 0\nv 1 0 x\nv 0 1 0\nf 1 2 3\n", "b'1 0 x'"),
        (b"f 1 2 3\n", "no vertices"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 99999999999 2 3\n", "corner 99999999999/"),
    ],
    "stl": [
        (stl([[[0, 0, 0], [1, 0, 0], [0, 0, 1]]], 3), "truncated or no STL"),
        (b"\0" * 50, "header alone"),
        (b"solid\nfacet normal 0 0 0\nvertex 0 0 0\nvertex 1 0 0\n", "three vertices"),
        (b"solid\nfacet\nvertex 0 0 0\nvertex 1 0 x\nvertex 0 1 0\n", "three vertices of three numbers"),
        (b"solid\nfacet normal\nendsolid\n", "0 faces"),
    ],
    "ply": [
        (ply(TRIANGLE, "3 0 1 3\n"), "beyond its 3"),
        (ply(TRIANGLE, "3 0 1 -1\n"), "beyond its 3"),
        (ply(TRIANGLE, "2 0 1\n"), "2 corners"),
        (ply(TRIANGLE, "3 0 1\n"), "row 0 of 1 of .face. in the PLY file ends beyond"),
        (ply(TRIANGLE, "3 0 1 x\n"), "no number"),
        (ply(TRIANGLE, "3 0 1 2\n", num_vertices=2_000_001), "2,000,001 vertices"),
        (ply(TRIANGLE, "", num_faces=0), "point cloud"),
        (
            ply("0 0 0 0 0\n", "").partition(b"element face")[0].replace(b"vertex 3", b"vertex 1")
            + b"property float f_dc_0\nproperty float rot_0\nend_header\n0 0 0 0 0\n",
            "Gaussian splat",
        ),
        (ply(TRIANGLE, "3 0 1 2\n").replace(b"vertex_indices", b"corners"), "no vertex_indices"),
        (ply(TRIANGLE, "3 0 1 2\n").replace(b"property float z", b"property float w"), "with x, y and z"),
        (
            b"ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\nelement vertex 3\n"
            b"property float x\nproperty float y\nproperty float z\nend_header\n3 0 1 2\n" + TRIANGLE.encode(),
            "before its vertices",
        ),
        (binary_ply("uchar int", b"\x03" + bytes(12) + b"\x02" + bytes(8)), "face 1 of the PLY file has 2 corners"),
        (binary_ply("uchar int", b""), "ends before a list"),
        (binary_ply("uchar int", b"\x03\0\0\0\0"), "row 0 of 2 of .face. .* ends beyond"),
        (binary_ply("uchar int", 2 * (b"\x02" + bytes(8))), "2 corners"),
        (binary_ply("int int", b"\xff\xff\xff\xff"), "-1 items"),
        (binary_ply("float int", b"\0" * 16), "length that is no whole number"),
        (binary_ply("uchar float", 2 * (b"\x03" + bytes(12))), "no index"),
        (binary_ply("uchar uint", 2 * (b"\x03" + b"\xff" * 12)), "no index"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "content", "message"), [(kind, *row) for kind, rows in BROKEN.items() for row in rows]
)
def test_a_file_that_breaks_the_rules_is_refused(kind: str, content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(content, kind)


@pytest.mark.parametrize("file_type", ["las", "points", "splat", "zip", "jpeg", "fbx"])
def test_other_kinds_of_file_are_refused_with_what_is_accepted(file_type: str) -> None:
    with pytest.raises(FormatError, match="OBJ, PLY with faces, STL, OFF, 3MF, COLLADA, glTF or GLB"):
        read(b"", file_type)


@pytest.mark.parametrize("reading", [{"unit_m": unit} for unit in (0.0, -1.0, np.nan, np.inf)] + [{"up_axis": "up"}])
def test_a_unit_that_is_no_length_or_an_axis_that_is_none_is_refused(rng, reading: dict) -> None:
    with pytest.raises(InputError, match=next(iter(reading))):
        read(mesh_bytes(trunk_and_crown(rng), "ply"), "ply", reading=Reading(**reading))


@pytest.mark.parametrize(
    ("head", "name", "expected"),
    [
        (b"glTF\x02\0\0\0", "x", "glb"),
        (b"ply\nformat", "x", "ply"),
        (b"ply\r\nformat", "x.txt", "ply"),
        (b'{"asset": {"version": "2.0"}}', "x", "gltf"),
        (b'  {\n "scene": 0', "x.gltf", "gltf"),
        (b"solid x\n facet normal", "x", "stl"),
        (b"\0" * 84, "a.STL", "stl"),
        (b"# made by\nv 0 0 1\n", "x", "obj"),
        (b"mtllib a.mtl\no tree\n", "x.obj", "obj"),
        (b"0.1 0.2 0.3\n1 2 3\n", "cloud.txt", "points"),
        (b"1,2,3\n", "cloud.xyz", "points"),
        (b"LASF\0", "x", "las"),
        (b"PK\x03\x04", "x", "zip"),
        (b"\x89PNG\r\n\x1a\n", "x", "png"),
        (b"\xff\xd8\xff\xe0", "x", "jpeg"),
        (b"\0" * 64, "x.splat", "splat"),
        (b"\x1f\x8b\x08", "x.spz", "spz"),
        (b"\x40\0\0\0\0\0\0\0{", "x", "safetensors"),
    ],
)
def test_formats_are_recognised_by_their_first_bytes(head: bytes, name: str, expected: str) -> None:
    assert sniff_file_type(head, name) == expected


@pytest.mark.parametrize("head", [b"hello", b"\0\x01\x02", b"MZ\x90"])
def test_what_is_of_no_known_kind_is_refused(head: bytes) -> None:
    with pytest.raises(FormatError, match="no known format") as refusal:
        sniff_file_type(head, "x.exe")
    taken = {*MESH_SUFFIXES, *CLOUD_SUFFIXES, *PHOTO_SUFFIXES, *FILM_SUFFIXES} - {".jpg", ".tif", ".heif", ".dae"}
    text = str(refusal.value).lower()  # it names COLLADA, and the other three by their long names
    assert [suffix for suffix in sorted(taken) if suffix.lstrip(".") not in text] == []
