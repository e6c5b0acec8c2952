"""OBJ, PLY and STL: parts, materials, encodings. And of every mesh file its axes and units."""

import io
import re

import numpy as np
import pytest
import trimesh
from PIL import Image

from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.mesh_file import sniff_file_type
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.axes_unit import guess_unit_m
from dynamictree.plant.upright import judge_up_axis
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation
from tests.formats.meshes import image_bytes, read, trunk_and_crown, written


def test_a_texture_that_several_materials_miss_is_warned_of_once_and_their_colours_stay(rng) -> None:
    stream = io.BytesIO()
    library = write_obj(trunk_and_crown(rng), stream, library="tree.mtl")["tree.mtl"]
    without = re.sub(rb"(newmtl .*)", rb"\1\nmap_Kd null", re.sub(rb"map_Kd .*", b"", library))
    mesh = read(stream.getvalue(), "obj", companions={"tree.mtl": without})
    assert [warning.code for warning in mesh.warnings if "'null'" in warning.message] == ["texture-missing"]
    assert (mesh.look.materials[1].texture_png, mesh.look.materials[1].base_color) == (None, (0.1, 0.5, 0.1, 1.0))


def test_obj_polygons_seams_negative_numbers_and_colours() -> None:
    text = b"""# a square with a seam, then a triangle counted backwards
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 0 1 0 0 1
v 0 0 1 1 1 1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
f 1/1 2/2 \\
  3/3 4/4
f -4/-1 -2/-3 -1/-4
"""
    mesh = read(text, "obj", reading=Reading(up_axis="+Z"))
    np.testing.assert_array_equal(mesh.vertices[:4], [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    np.testing.assert_array_equal(mesh.vertices[mesh.faces[2]], mesh.vertices[[0, 2, 3]])
    np.testing.assert_array_equal(mesh.faces[:2], [[0, 1, 2], [0, 2, 3]])
    assert mesh.num_vertices == 7  # three corners of the second face lie elsewhere on the texture
    np.testing.assert_array_equal(mesh.look.uv[mesh.faces[2]], [[0, 0], [1, 1], [0, 1]])  # v downward
    colors = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]]
    np.testing.assert_array_equal(mesh.look.vertex_colors[:4, :3], colors)


def test_stl_binary_and_ascii_share_their_equal_corners() -> None:
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 2], [0, 2, 3]], process=False)
    for form in ("stl", "stl_ascii"):
        content = square.export(file_type=form)
        content = content.encode() if isinstance(content, str) else content
        assert sniff_file_type(content[:1024], "a.stl") == "stl"
        mesh = read(content, "stl", reading=Reading(up_axis="+Z"))
        np.testing.assert_array_equal(mesh.vertices, square.vertices)
        np.testing.assert_array_equal(mesh.faces, square.faces)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("mixed", [False, True])
def test_ply_of_every_encoding(form: str, mixed: bool) -> None:
    head = (
        f"ply\nformat {form} 1.0\ncomment x\nelement vertex 4\nproperty double x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nelement edge 1\nproperty int a\n"
        "element face 2\nproperty uchar flags\nproperty list uchar int vertex_index\n"
        "property list uchar float weights\n"
        "end_header\n"
    )
    order = ">" if "big" in form else "<"
    rows = np.zeros(4, [("x", order + "f8"), ("yz", order + "f4", 2), ("color", "u1", 3)])
    rows["x"], rows["color"] = [0, 1, 1, 0], [[1, 2, 3]] * 4
    rows["yz"] = [[0, 0], [0, 0], [0, 1], [0, 1]]
    polygons = [[0, 1, 2], [0, 1, 2, 3]] if mixed else [[0, 1, 2], [0, 2, 3]]
    if form == "ascii":
        body = "".join(f"{x} {y} {z} {r} {g} {b}\n" for x, (y, z), (r, g, b) in rows.tolist()) + "7\n"
        body += "".join(f"9 {len(p)} {' '.join(map(str, p))} 1 0.5\n" for p in polygons)
        content = body.encode()
    else:
        content = rows.tobytes() + np.array([7], order + "i4").tobytes()
        for polygon in polygons:
            content += bytes([9, len(polygon)]) + np.array(polygon, order + "i4").tobytes()
            content += b"\x01" + np.array([0.5], order + "f4").tobytes()
    mesh = read(head.encode() + content, "ply", reading=Reading(up_axis="+Z"))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    expected = [[0, 1, 2], [0, 1, 2], [0, 2, 3]] if mixed else [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_array_equal(mesh.faces, expected)
    np.testing.assert_array_equal(mesh.look.vertex_colors[0], [1, 2, 3, 255])


@pytest.mark.parametrize(("start", "end"), [(b"ply", b" \r\n "), (b"\xef\xbb\xbfply", b"\n"), (b"ply", b"\t\n")])
def test_blanks_around_the_lines_of_a_ply_mean_nothing(start: bytes, end: bytes) -> None:
    axes = [b"property float " + axis for axis in (b"x", b"y", b"z")]
    header = [start, b"format ascii 1.0", b"element vertex 3", *axes, b"element face 1"]
    rows = [b"0 0 0", b"1 0 0", b"0 0 5", b"3 0 1 2", b""]
    content = end.join([*header, b"property list uchar int vertex_index", b"end_header", *rows])
    assert sniff_file_type(content, "a.ply") == "ply"
    assert read(content, "ply").num_faces == 1


@pytest.mark.parametrize(("trunk", "colors"), [("9 8 7 255", [[9, 8, 7, 255], [255] * 4]), ("0 0 0 0", None)])
def test_vertices_of_a_ply_that_were_given_no_colour_are_not_black(trunk: str, colors: list[list[int]] | None) -> None:
    names = [*(f"float {axis}" for axis in "xyz"), *(f"uchar {name}" for name in ("red", "green", "blue", "alpha"))]
    header = ["ply", "format ascii 1.0", "element vertex 6", *(f"property {name}" for name in names), "element face 2"]
    places = ("0 0 0", "1 0 0", "0 0 5", "0 0 5", "1 0 5", "0 0 9")
    rows = [f"{place} {trunk if row < 3 else '0 0 0 0'}" for row, place in enumerate(places)]
    lines = [*header, "property list uchar int vertex_indices", "end_header", *rows, "3 0 1 2", "3 3 4 5", ""]
    result = read("\n".join(lines).encode(), "ply").look.vertex_colors
    assert (None if result is None else result[[0, 3]].tolist()) == colors


def test_ply_takes_the_texture_that_its_comment_names(rng) -> None:
    content = written(write_ply, trunk_and_crown(rng))
    content = content.replace(b"1.0\n", b"1.0\ncomment TextureFile bark.png\n", 1)
    mesh = read(content, "ply", companions={"bark.png": image_bytes()})
    assert mesh.look.materials[0].texture_png == image_bytes()


@pytest.mark.parametrize("axis", ["+Y", "+Z"])
@pytest.mark.parametrize("kind", ["obj", "ply", "stl"])
def test_the_axis_that_the_tree_stands_on_is_found(rng, axis: str, kind: str) -> None:
    mesh = trunk_and_crown(rng)
    content = trimesh.Trimesh(mesh.vertices @ up_rotation(axis), mesh.faces, process=False).export(file_type=kind)
    result = read(content.encode() if isinstance(content, str) else content, kind)
    assert result.source.up_axis == axis
    assert result.height_m == pytest.approx(mesh.height_m, rel=1e-5)


def test_a_mesh_without_faces_or_area_has_no_axis_to_find() -> None:
    points = np.eye(3, dtype=np.float32)
    for count in (0, 1):
        result = judge_up_axis(TriangleMesh(vertices=points, faces=np.zeros((count, 3), np.int32)))
        assert (result.axis, result.confidence) == ("+Z", 0.0)


@pytest.mark.parametrize(
    ("height", "unit"),
    [(0.5, 1.0), (25.0, 1.0), (120.0, 1.0), (121.0, 0.01), (900.0, 0.01), (20000.0, 0.001), (1e9, 1.0)],
)
def test_units_follow_from_how_tall_a_tree_can_be(height: float, unit: float) -> None:
    assert guess_unit_m(height) == unit


@pytest.mark.parametrize(
    ("kind", "mode", "value", "seen"),
    [("PNG", "I;16", 0x8080, 128), ("TIFF", "I;16", 0x8080, 128), ("TIFF", "F", 0.5, 128), ("DDS", "RGB", 90, 90)],
)
def test_textures_of_many_bits_and_of_engines_keep_their_brightness(
    kind: str, mode: str, value: float, seen: int
) -> None:
    stream = io.BytesIO()
    pixels = np.full((4, 4) if mode != "RGB" else (4, 4, 3), value, {"I;16": "<u2", "F": "<f4", "RGB": "u1"}[mode])
    Image.fromarray(pixels).save(stream, kind)
    library = b"newmtl leaf\nKd 1 1 1\nmap_Kd leaf.png\n"
    content = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 2 0\nvt 0 0\nusemtl leaf\nf 1/1 2/1 3/1\n"
    mesh = read(content, "obj", companions={"a.mtl": library, "leaf.png": stream.getvalue()})
    decoded = np.asarray(Image.open(io.BytesIO(mesh.look.materials[0].texture_png)).convert("RGB"))
    np.testing.assert_allclose(decoded, seen, atol=1)


@pytest.mark.parametrize(("kind", "units", "unit"), [("obj", 100, 0.01), ("stl", 500, 0.001), ("stl", 1, 1.0)])
def test_a_unit_that_was_guessed_is_said(rng, kind: str, units: float, unit: float) -> None:
    mesh = trunk_and_crown(rng)
    content = trimesh.Trimesh(mesh.vertices * units, mesh.faces, process=False).export(file_type=kind)
    result = read(content.encode() if isinstance(content, str) else content, kind)
    assert result.source.scale == unit
    doubts = [warning.message for warning in result.warnings if warning.code == "size-doubtful"]
    assert [f"{result.height_m / unit:.4g} units" in doubt for doubt in doubts] == [True] * (unit != 1)


def test_names_with_umlauts_of_windows_programs_find_their_files() -> None:
    content = "mtllib Größe.mtl\nv 0 0 0\nv 1 0 0\nv 0 2 0\nusemtl Blätter\nf 1 2 3\n".encode("latin-1")
    library = "newmtl Blätter\nKd 0.1 0.6 0.1\n".encode("latin-1")
    mesh = read(content, "obj", companions={"Größe.mtl": library})
    assert [material.name for material in mesh.look.materials] == ["Blätter"]
    assert mesh.look.materials[0].base_color[1] > mesh.look.materials[0].base_color[0]


def test_every_sample_mesh_is_read(samples) -> None:
    files = [path for path in (samples / "mesh").rglob("*") if path.suffix in (".glb", ".gltf", ".obj", ".ply", ".stl")]
    assert len(files) >= 2
    for path in files:
        companions = {other.name: other.read_bytes() for other in path.parent.iterdir() if other.is_file()}
        kind = sniff_file_type(path.read_bytes()[:4096], path.name)
        mesh = read(path.read_bytes(), kind, companions=companions)
        expected = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type=kind, process=False)
        assert mesh.num_faces == sum(len(part.faces) for part in expected.geometry.values())
        assert 2.5 < mesh.height_m < 5.5, path.name
        assert mesh.source.up_axis == "+Y", path.name
        assert len(mesh.look.materials) >= 1
