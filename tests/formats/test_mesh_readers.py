"""Mesh files of every kind: parts, materials, placed and instanced nodes, encodings, axes and units."""

import base64
import io
import json
from pathlib import Path

import DracoPy
import numpy as np
import pytest
import trimesh

from dynamictree.formats.axes import detect_up_axis, guess_unit_m, up_rotation
from dynamictree.formats.gltf import write_glb
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.formats.obj_writer import write_obj
from dynamictree.formats.ply_writer import write_ply
from dynamictree.mesh import TriangleMesh
from tests.formats.meshes import gltf_bytes, image_bytes, triangle_gltf, trunk_and_crown

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], np.float32)  # of triangle_gltf, +Z up


def read(content: bytes, file_type: str, **options: object) -> TriangleMesh:
    return read_mesh(io.BytesIO(content), file_type=file_type, **options)  # type: ignore[arg-type]


def read_gltf(**changes: object) -> TriangleMesh:
    root, binary = triangle_gltf(**changes)
    return read(gltf_bytes(root, binary), "glb")


def with_data(extra: bytes, *views: dict[str, object], **changes: object) -> TriangleMesh:
    """The triangle's document with more bytes, and more views that begin behind its 42."""
    root, binary = triangle_gltf(**changes)
    assert isinstance(root["bufferViews"], list)
    root["bufferViews"] += [{"buffer": 0, **view} for view in views]
    root["buffers"] = [{"byteLength": 44 + len(extra)}]
    return read(gltf_bytes(root, binary + b"\0\0" + extra), "glb")


def test_gltf_turns_from_y_up_to_z_up() -> None:
    mesh = read_gltf()
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
    assert mesh.source_up_axis == "+Y"
    assert mesh.source_scale == 1.0
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])


def test_gltf_told_otherwise_follows_what_it_is_told() -> None:
    root, binary = triangle_gltf()
    mesh = read(gltf_bytes(root, binary), "glb", up_axis="+Z", unit_m=0.01)
    np.testing.assert_allclose(mesh.vertices, np.float32([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]))
    assert (mesh.source_up_axis, mesh.source_scale) == ("+Z", 0.01)


def test_nodes_place_scale_and_turn_their_meshes() -> None:
    half_turn = [0, 1, 0, 0]  # about +Y of the file, +Z here
    nodes = [{"children": [1], "translation": [0, 5, 0]}, {"mesh": 0, "rotation": half_turn, "scale": [2, 3, 1]}]
    np.testing.assert_allclose(read_gltf(nodes=nodes).vertices, [[0, 0, 5], [-2, 0, 5], [0, 0, 8]], atol=1e-6)


def test_a_node_s_matrix_is_stored_by_columns() -> None:
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1]
    mesh = read_gltf(nodes=[{"mesh": 0, "matrix": matrix}])
    np.testing.assert_allclose(mesh.vertices[0], [7, -9, 8])


def test_a_mirrored_node_keeps_the_outside_outside() -> None:
    np.testing.assert_array_equal(read_gltf(nodes=[{"mesh": 0, "scale": [-1, 1, 1]}]).faces, [[2, 1, 0]])


def test_one_mesh_in_three_nodes_stands_three_times() -> None:
    nodes = [{"mesh": 0, "translation": [i, 0, 0]} for i in range(3)]
    mesh = read_gltf(nodes=nodes, scenes=[{"nodes": [0, 1, 2]}])
    assert (mesh.num_vertices, mesh.num_faces) == (9, 3)
    np.testing.assert_allclose(mesh.vertices[::3, 0], [0, 1, 2])


def test_gpu_instances_stand_where_they_are_put() -> None:
    places = np.array([[0, 0, 0], [4, 0, 0]], np.float32)
    mesh = with_data(
        places.tobytes(),
        {"byteOffset": 44, "byteLength": 24},
        nodes=[{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}}}],
        accessors=[
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"},
        ],
    )
    np.testing.assert_allclose(mesh.vertices[[0, 3], 0], [0, 4])


def test_nodes_outside_of_the_scene_are_left_out_and_without_a_scene_all_are_in() -> None:
    nodes = [{"mesh": 0}, {"mesh": 0}]
    assert read_gltf(nodes=nodes).num_faces == 1
    root, binary = triangle_gltf(nodes=nodes)
    del root["scene"], root["scenes"]
    assert read(gltf_bytes(root, binary), "glb").num_faces == 2


def test_a_skin_at_rest_places_its_mesh_by_its_joints_alone() -> None:
    joints, weights = np.zeros((3, 4), np.uint8), np.tile(np.float32([1, 0, 0, 0]), (3, 1))
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
        {"bufferView": 2, "componentType": 5121, "count": 3, "type": "VEC4"},
        {"bufferView": 3, "componentType": 5126, "count": 3, "type": "VEC4"},
        {"bufferView": 4, "componentType": 5126, "count": 1, "type": "MAT4"},
    ]
    bind = np.eye(4, dtype=np.float32)
    bind[3, :3] = [0, -1, 0]  # by columns: moves down by 1
    mesh = with_data(
        joints.tobytes() + weights.tobytes() + bind.tobytes(),
        {"byteOffset": 44, "byteLength": 12},
        {"byteOffset": 56, "byteLength": 48},
        {"byteOffset": 104, "byteLength": 64},
        accessors=accessors,
        meshes=[{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}}]}],
        nodes=[{"mesh": 0, "skin": 0, "translation": [100, 0, 0]}, {"translation": [0, 3, 0]}],
        scenes=[{"nodes": [0, 1]}],
        skins=[{"joints": [1], "inverseBindMatrices": 3}],
    )
    np.testing.assert_allclose(mesh.vertices, CORNERS + np.array([0, 0, 2]), atol=1e-6)


def test_a_primitive_without_indices_takes_its_vertices_in_order() -> None:
    np.testing.assert_array_equal(
        read_gltf(meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}]).faces, [[0, 1, 2]]
    )


@pytest.mark.parametrize(("mode", "expected"), [(5, [[0, 1, 2], [1, 3, 2]]), (6, [[0, 1, 2], [0, 2, 3]])])
def test_strips_and_fans_become_triangles(mode: int, expected: list[list[int]]) -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    mesh = with_data(
        square.tobytes(),
        {"byteOffset": 44, "byteLength": 48},
        accessors=[{"bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC3"}],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}],
    )
    np.testing.assert_array_equal(mesh.faces, expected)


def test_points_and_lines_beside_triangles_are_passed_over() -> None:
    primitives = [{"attributes": {"POSITION": 0}, "mode": mode} for mode in (0, 1, 4)]
    assert read_gltf(meshes=[{"primitives": primitives}]).num_faces == 1


def test_a_sparse_accessor_replaces_some_elements() -> None:
    sparse = {
        "count": 1,
        "indices": {"bufferView": 2, "componentType": 5121},
        "values": {"bufferView": 3},
    }
    mesh = with_data(
        b"\x01\0\0\0" + np.float32([9, 0, 0]).tobytes(),
        {"byteOffset": 44, "byteLength": 4},
        {"byteOffset": 48, "byteLength": 12},
        accessors=[{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
    )
    np.testing.assert_array_equal(mesh.vertices[:, 0], [0, 9, 0])


def test_a_sparse_accessor_may_stand_on_zeros() -> None:
    sparse = {"count": 2, "indices": {"bufferView": 2, "componentType": 5121}, "values": {"bufferView": 3}}
    mesh = with_data(
        b"\x01\x02\0\0" + np.float32([1, 0, 0, 0, 1, 0]).tobytes(),
        {"byteOffset": 44, "byteLength": 2},
        {"byteOffset": 48, "byteLength": 24},
        accessors=[{"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
    )
    np.testing.assert_array_equal(mesh.vertices, CORNERS)


def test_interleaved_and_normalised_attributes_are_read() -> None:
    """KHR_mesh_quantization: positions as normalised int16, 8 bytes apart, with bytes of colour and uint16 places."""
    rows = np.zeros(3, [("position", "<i2", (3,)), ("pad", "<i2")])
    rows["position"] = [[0, 0, 0], [32767, 0, 0], [0, -32767, 0]]
    colors, places = np.array([[255, 0, 0, 128]] * 3, np.uint8), np.array([[0, 65535]] * 3, np.uint16)
    mesh = with_data(
        rows.tobytes() + colors.tobytes() + places.tobytes(),
        {"byteOffset": 44, "byteLength": 24, "byteStride": 8},
        {"byteOffset": 68, "byteLength": 12},
        {"byteOffset": 80, "byteLength": 12},
        extensionsRequired=["KHR_mesh_quantization"],
        accessors=[
            {"bufferView": 2, "componentType": 5122, "count": 3, "type": "VEC3", "normalized": True},
            {"bufferView": 3, "componentType": 5121, "count": 3, "type": "VEC4", "normalized": True},
            {"bufferView": 4, "componentType": 5123, "count": 3, "type": "VEC2", "normalized": True},
        ],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1, "TEXCOORD_0": 2}}]}],
    )
    np.testing.assert_allclose(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 0, -1]])
    assert mesh.uv is not None
    np.testing.assert_array_equal(mesh.uv, [[0, 1]] * 3)
    assert mesh.vertex_colors is not None
    np.testing.assert_array_equal(mesh.vertex_colors, [[255, 0, 0, 128]] * 3)


def test_a_texture_s_transform_moves_its_coordinates() -> None:
    places = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 1]}
    texture = {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": transform}}
    image = base64.b64encode(image_bytes()).decode()
    mesh = with_data(
        places.tobytes(),
        {"byteOffset": 44, "byteLength": 24},
        accessors=[
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC2"},
        ],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_1": 1}, "material": 0}]}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": texture}, "alphaMode": "BLEND"}],
        textures=[{"source": 0}],
        images=[{"uri": f"data:image/png;base64,{image}"}],
    )
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv, [[0.5, 0.25], [0.5, -1.75], [1.5, 0.25]], atol=1e-6)
    assert mesh.materials[0].texture_png == image_bytes()
    assert mesh.materials[0].alpha_cutoff == 0.5


def test_a_jpeg_texture_becomes_png() -> None:
    jpeg = base64.b64encode(image_bytes("JPEG")).decode()
    mesh = read_gltf(
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        textures=[{"source": 0}],
        images=[{"uri": f"data:image/jpeg;base64,{jpeg}"}],
    )
    assert mesh.materials[0].texture_png is not None
    assert mesh.materials[0].texture_png.startswith(b"\x89PNG")


def test_a_texture_without_an_image_is_none() -> None:
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "alphaMode": "MASK", "alphaCutoff": 0.3}
    mesh = read_gltf(materials=[material], textures=[{}])
    assert mesh.materials[0].texture_png is None
    assert mesh.materials[0].alpha_cutoff == 0.3


def test_a_part_without_a_material_gets_a_white_one() -> None:
    primitives = [{"attributes": {"POSITION": 0}, "material": 0}, {"attributes": {"POSITION": 0}, "indices": 1}]
    mesh = read_gltf(meshes=[{"primitives": primitives}], materials=[{"name": "bark"}])
    assert [material.name for material in mesh.materials] == ["bark", "default"]
    assert mesh.face_material is not None
    np.testing.assert_array_equal(mesh.face_material, [0, 1])
    assert mesh.num_vertices == 3  # one list of vertices for both


def test_a_part_without_colours_is_white_beside_one_with() -> None:
    colors = np.array([[1, 0, 0]] * 3, np.float32)
    mesh = with_data(
        colors.tobytes(),
        {"byteOffset": 44, "byteLength": 36},
        accessors=[
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC3"},
        ],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}}, {"attributes": {"POSITION": 0, "COLOR_0": 1}}]}],
    )
    assert mesh.vertex_colors is not None
    np.testing.assert_array_equal(mesh.vertex_colors[[0, 3]], [[255, 255, 255, 255], [255, 0, 0, 255]])


def test_json_gltf_takes_its_buffers_from_data_uris_or_from_beside_it() -> None:
    root, binary = triangle_gltf()
    root["buffers"] = [{"byteLength": 42, "uri": "./tree%20data.bin"}]
    outside = read(json.dumps(root).encode(), "gltf", companions={"tree data.bin": binary})
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    root["buffers"] = [{"byteLength": 42, "uri": uri}]
    inside = read(json.dumps(root).encode(), "gltf")
    np.testing.assert_array_equal(outside.vertices, inside.vertices)


def test_draco_is_decoded(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    stream = DracoPy.encode(
        mesh.vertices[:, [0, 2, 1]] * [1, 1, -1],
        mesh.faces,
        quantization_bits=20,
        preserve_order=True,
        tex_coord=mesh.uv.astype(np.float64),
    )
    decoded = DracoPy.decode(stream)
    names = {0: "POSITION", 3: "TEXCOORD_0"}  # draco's attribute types
    identities = {names[int(a["attribute_type"])]: int(a["unique_id"]) for a in decoded.attributes}
    primitive = {
        "attributes": {"POSITION": 0, "TEXCOORD_0": 2},
        "indices": 1,
        "extensions": {"KHR_draco_mesh_compression": {"bufferView": 2, "attributes": identities}},
    }
    found = with_data(
        stream,
        {"byteOffset": 44, "byteLength": len(stream)},
        extensionsRequired=["KHR_draco_mesh_compression"],
        meshes=[{"primitives": [primitive]}],
        accessors=[
            {"componentType": 5126, "count": mesh.num_vertices, "type": "VEC3"},
            {"componentType": 5125, "count": 3 * mesh.num_faces, "type": "SCALAR"},
            {"componentType": 5126, "count": mesh.num_vertices, "type": "VEC2"},
        ],
    )
    np.testing.assert_allclose(found.vertices, mesh.vertices, atol=1e-4)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    assert found.uv is not None
    assert mesh.uv is not None
    np.testing.assert_allclose(found.uv, mesh.uv, atol=1e-2)


def test_whole_numbers_may_be_written_with_a_point() -> None:
    assert read_gltf(nodes=[{"mesh": 0.0}]).num_faces == 1


def test_required_extensions_of_the_look_alone_do_not_matter() -> None:
    assert read_gltf(extensionsRequired=["KHR_materials_unlit", "KHR_lights_punctual"]).num_faces == 1


def test_an_obj_whose_texture_was_not_sent_along_keeps_its_colour(rng: np.random.Generator) -> None:
    stream = io.BytesIO()
    library = write_obj(trunk_and_crown(rng), stream, library="tree.mtl")["tree.mtl"]
    mesh = read(stream.getvalue(), "obj", companions={"tree.mtl": library})
    assert mesh.materials[1].texture_png is None
    assert mesh.materials[1].base_color == (0.1, 0.5, 0.1, 1.0)


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
    mesh = read(text, "obj", up_axis="+Z")
    np.testing.assert_array_equal(mesh.vertices[:4], [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    np.testing.assert_array_equal(mesh.vertices[mesh.faces[2]], mesh.vertices[[0, 2, 3]])
    np.testing.assert_array_equal(mesh.faces[:2], [[0, 1, 2], [0, 2, 3]])
    assert mesh.num_vertices == 7  # three corners of the second face lie elsewhere on the texture
    assert mesh.uv is not None
    np.testing.assert_array_equal(mesh.uv[mesh.faces[2]], [[0, 0], [1, 1], [0, 1]])  # v downward
    assert mesh.vertex_colors is not None
    np.testing.assert_array_equal(mesh.vertex_colors[:4, :3], [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]])


def test_stl_binary_and_ascii_share_their_equal_corners() -> None:
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 2], [0, 2, 3]], process=False)
    for form in ("stl", "stl_ascii"):
        content = square.export(file_type=form)
        content = content.encode() if isinstance(content, str) else content
        assert sniff_file_type(content[:1024], "a.stl") == "stl"
        mesh = read(content, "stl", up_axis="+Z")
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
    mesh = read(head.encode() + content, "ply", up_axis="+Z")
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])
    expected = [[0, 1, 2], [0, 1, 2], [0, 2, 3]] if mixed else [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_array_equal(mesh.faces, expected)
    assert mesh.vertex_colors is not None
    np.testing.assert_array_equal(mesh.vertex_colors[0], [1, 2, 3, 255])


def test_ply_takes_the_texture_that_its_comment_names(rng: np.random.Generator) -> None:
    stream = io.BytesIO()
    write_ply(trunk_and_crown(rng), stream)
    content = stream.getvalue().replace(b"1.0\n", b"1.0\ncomment TextureFile bark.png\n", 1)
    mesh = read(content, "ply", companions={"bark.png": image_bytes()})
    assert mesh.materials[0].texture_png == image_bytes()


@pytest.mark.parametrize("axis", ["+X", "-X", "+Y", "-Y", "+Z", "-Z"])
def test_every_axis_turns_to_z_up_without_mirroring(axis: str) -> None:
    rotation = up_rotation(axis)
    direction = np.zeros(3)
    direction["XYZ".index(axis[1])] = 1 if axis[0] == "+" else -1
    np.testing.assert_array_equal(rotation @ direction, [0, 0, 1])
    assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize("axis", ["+Y", "+Z"])
@pytest.mark.parametrize("file_type", ["obj", "ply", "stl"])
def test_the_axis_that_the_tree_stands_on_is_found(rng: np.random.Generator, axis: str, file_type: str) -> None:
    mesh = trunk_and_crown(rng)
    laid = mesh.with_vertices((mesh.vertices @ up_rotation(axis)).astype(np.float32))
    stream = io.BytesIO()
    if file_type == "stl":
        stream.write(trimesh.Trimesh(laid.vertices, laid.faces, process=False).export(file_type="stl"))
    else:
        {"obj": write_obj, "ply": write_ply}[file_type](laid, stream)
    found = read(stream.getvalue(), file_type)
    assert found.source_up_axis == axis
    assert found.height_m == pytest.approx(mesh.height_m, rel=1e-5)


def test_a_shape_without_a_foot_stands_on_its_longer_axis(rng: np.random.Generator) -> None:
    ball = rng.normal(size=(400, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    faces = rng.integers(0, 400, (4000, 3)).astype(np.int32)
    for scale, axis in (([1, 1.2, 1], "+Y"), ([1, 1, 1.2], "+Z")):
        assert detect_up_axis(TriangleMesh(vertices=(ball * scale).astype(np.float32), faces=faces)) == axis


def test_a_mesh_without_faces_or_area_has_no_axis_to_find() -> None:
    points = np.eye(3, dtype=np.float32)
    assert detect_up_axis(TriangleMesh(vertices=points, faces=np.zeros((0, 3), np.int32))) == "+Z"
    assert detect_up_axis(TriangleMesh(vertices=points, faces=np.zeros((1, 3), np.int32))) == "+Z"


@pytest.mark.parametrize(
    ("height", "unit"),
    [(0.5, 1.0), (25.0, 1.0), (120.0, 1.0), (121.0, 0.01), (900.0, 0.01), (20000.0, 0.001), (1e9, 1.0)],
)
def test_units_follow_from_how_tall_a_tree_can_be(height: float, unit: float) -> None:
    assert guess_unit_m(height) == unit


def test_centimetres_are_found_and_recorded(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    stream = io.BytesIO()
    write_ply(mesh.with_vertices(mesh.vertices * np.float32(100)), stream)
    found = read(stream.getvalue(), "ply")
    assert found.source_scale == 0.01
    np.testing.assert_allclose(found.vertices, mesh.vertices, rtol=1e-5, atol=1e-5)


def test_every_sample_mesh_is_read(samples: Path) -> None:
    files = [path for path in (samples / "mesh").rglob("*") if path.suffix in (".glb", ".gltf", ".obj", ".ply", ".stl")]
    assert len(files) >= 2
    for path in files:
        companions = {other.name: other.read_bytes() for other in path.parent.iterdir() if other.is_file()}
        kind = sniff_file_type(path.read_bytes()[:4096], path.name)
        mesh = read(path.read_bytes(), kind, companions=companions)
        expected = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type=kind, process=False)
        assert mesh.num_faces == sum(len(part.faces) for part in expected.geometry.values())
        assert 2.5 < mesh.height_m < 5.5, path.name
        assert mesh.source_up_axis == "+Y", path.name
        assert len(mesh.materials) >= 1


def test_a_written_glb_is_read_by_trimesh(rng: np.random.Generator) -> None:
    mesh, stream = trunk_and_crown(rng), io.BytesIO()
    write_glb(mesh, stream)
    scene = trimesh.load_scene(io.BytesIO(stream.getvalue()), file_type="glb", process=False)
    merged = trimesh.util.concatenate(list(scene.geometry.values()))
    low, high = merged.bounds @ up_rotation("+Y").T
    np.testing.assert_allclose(
        np.sort([low, high], axis=0), [mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], atol=1e-5
    )
