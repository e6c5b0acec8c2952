"""glTF and GLB: parts, materials, placed and instanced nodes, accessors, textures, Draco."""

import base64
import json

import DracoPy
import numpy as np
import pytest

from dynamictree.formats.gltf.template import can_carry_joints
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats.meshes import gltf_bytes, image_bytes, read, triangle_gltf, trunk_and_crown

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], np.float32)  # of triangle_gltf, +Z up


def read_gltf(**changes: object) -> TriangleMesh:
    root, binary = triangle_gltf(**changes)
    return read(gltf_bytes(root, binary), "glb")


def floats(view: int, kind: str, *, count: int = 3) -> dict[str, object]:
    """An accessor of single precision."""
    return {"bufferView": view, "componentType": 5126, "count": count, "type": kind}


def with_data(extra: bytes, *views: dict[str, object], **changes: object) -> TriangleMesh:
    """The triangle's document with more bytes, and more views that begin behind its 42."""
    root, binary = triangle_gltf(**changes)
    root["bufferViews"] += [{"buffer": 0, **view} for view in views]
    root["buffers"] = [{"byteLength": 44 + len(extra)}]
    return read(gltf_bytes(root, binary + b"\0\0" + extra), "glb")


def test_gltf_turns_from_y_up_to_z_up() -> None:
    mesh = read_gltf()
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
    assert mesh.source.up_axis == "+Y"
    assert mesh.source.scale == 1.0
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])


def test_gltf_follows_explicit_axes_and_units() -> None:
    root, binary = triangle_gltf()
    mesh = read(gltf_bytes(root, binary), "glb", reading=Reading(up_axis="+Z", unit_m=0.01))
    np.testing.assert_allclose(mesh.vertices, np.float32([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]))
    assert (mesh.source.up_axis, mesh.source.scale) == ("+Z", 0.01)


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
            floats(0, "VEC3"),
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
            floats(2, "VEC3", count=2),
        ],
    )
    np.testing.assert_allclose(mesh.vertices[[0, 3], 0], [0, 4])


def test_without_a_scene_all_nodes_are_in() -> None:
    root, binary = triangle_gltf(nodes=[{"mesh": 0}, {"mesh": 0}])
    del root["scene"], root["scenes"]
    assert read(gltf_bytes(root, binary), "glb").num_faces == 2


def test_a_skin_at_rest_places_its_mesh_by_its_joints_alone() -> None:
    joints, weights = np.zeros((3, 4), np.uint8), np.tile(np.float32([1, 0, 0, 0]), (3, 1))
    accessors = [
        floats(0, "VEC3"),
        {"bufferView": 2, "componentType": 5121, "count": 3, "type": "VEC4"},
        floats(3, "VEC4"),
        floats(4, "MAT4", count=1),
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


@pytest.mark.parametrize(
    "changes",
    [
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]},  # no indices: vertices in their order
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode} for mode in (0, 1, 4)]}]},
        {"nodes": [{"mesh": 0.0}]},
        {"extensionsRequired": ["KHR_materials_unlit", "KHR_lights_punctual"]},  # of the look alone
        {"buffers": [{"byteLength": 43}]},  # padding of the chunk may be counted
        {"nodes": [{"mesh": 0}, {"mesh": 0}]},  # outside of the scene
        {"nodes": [{"mesh": 0}, {"children": [2], "name": "a"}, {"children": [1]}]},
        {"nodes": [{"mesh": 0}, {"children": [2]}, {"children": [1]}]},
    ],
)
def test_what_is_unusual_and_allowed_is_read(changes: dict[str, object]) -> None:
    np.testing.assert_array_equal(read_gltf(**changes).faces, [[0, 1, 2]])


@pytest.mark.parametrize(("mode", "expected"), [(5, [[0, 1, 2], [1, 3, 2]]), (6, [[0, 1, 2], [0, 2, 3]])])
def test_strips_and_fans_become_triangles(mode: int, expected: list[list[int]]) -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    mesh = with_data(
        square.tobytes(),
        {"byteOffset": 44, "byteLength": 48},
        accessors=[floats(2, "VEC3", count=4)],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}],
    )
    np.testing.assert_array_equal(mesh.faces, expected)


@pytest.mark.parametrize(
    ("base", "rows", "values", "expected"),
    [
        ({"bufferView": 0}, [1], [[9, 0, 0]], [[0, 0, 0], [9, 0, 0], [0, 0, 1]]),
        ({}, [1, 2], [[1, 0, 0], [0, 1, 0]], CORNERS),  # on zeros
    ],
)
def test_a_sparse_accessor_replaces_some_elements(
    base: dict[str, int], rows: list[int], values: list[list[int]], expected: object
) -> None:
    indices, parts = {"bufferView": 2, "componentType": 5121}, {"bufferView": 3}
    sparse = {"sparse": {"count": len(rows), "indices": indices, "values": parts}}
    mesh = with_data(
        bytes(rows).ljust(4, b"\0") + np.float32(values).tobytes(),
        {"byteOffset": 44, "byteLength": len(rows)},
        {"byteOffset": 48, "byteLength": 12 * len(rows)},
        accessors=[base | {"componentType": 5126, "count": 3, "type": "VEC3"} | sparse],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
    )
    np.testing.assert_array_equal(mesh.vertices, expected)


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
    np.testing.assert_array_equal(mesh.look.uv, [[0, 1]] * 3)
    np.testing.assert_array_equal(mesh.look.vertex_colors, [[255, 0, 0, 128]] * 3)


def test_a_texture_s_transform_moves_its_coordinates() -> None:
    places = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 1]}
    texture = {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": transform}}
    image = base64.b64encode(image_bytes()).decode()
    mesh = with_data(
        places.tobytes(),
        {"byteOffset": 44, "byteLength": 24},
        accessors=[floats(0, "VEC3"), floats(2, "VEC2")],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_1": 1}, "material": 0}]}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": texture}, "alphaMode": "BLEND"}],
        textures=[{"source": 0}],
        images=[{"uri": f"data:image/png;base64,{image}"}],
    )
    np.testing.assert_allclose(mesh.look.uv, [[0.5, 0.25], [0.5, -1.75], [1.5, 0.25]], atol=1e-6)
    assert mesh.look.materials[0].texture_png == image_bytes()
    assert mesh.look.materials[0].alpha_cutoff == 0.5


def test_the_colour_of_glossy_materials_is_read() -> None:
    glossy = {"diffuseFactor": [0.1, 0.4, 0.2, 1.0], "diffuseTexture": {"index": 0}}
    uri = "data:image/png;base64," + base64.b64encode(image_bytes()).decode()
    mesh = read_gltf(
        materials=[{"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}],
        images=[{"uri": uri}],
        textures=[{"source": 0}],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
    )
    assert mesh.look.materials[0].base_color == (0.1, 0.4, 0.2, 1.0)
    assert mesh.look.materials[0].texture_png == image_bytes()


def test_a_texture_without_an_image_is_none() -> None:
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "alphaMode": "MASK", "alphaCutoff": 0.3}
    mesh = read_gltf(materials=[material], textures=[{}])
    assert mesh.look.materials[0].texture_png is None
    assert mesh.look.materials[0].alpha_cutoff == 0.3


def test_a_part_without_a_material_gets_a_white_one() -> None:
    primitives = [{"attributes": {"POSITION": 0}, "material": 0}, {"attributes": {"POSITION": 0}, "indices": 1}]
    mesh = read_gltf(meshes=[{"primitives": primitives}], materials=[{"name": "bark"}])
    assert [material.name for material in mesh.look.materials] == ["bark", "default"]
    np.testing.assert_array_equal(mesh.look.face_material, [0, 1])
    assert mesh.num_vertices == 3  # one list of vertices for both


def test_a_part_without_colours_is_white_beside_one_with() -> None:
    colors = np.array([[1, 0, 0]] * 3, np.float32)
    mesh = with_data(
        colors.tobytes(),
        {"byteOffset": 44, "byteLength": 36},
        accessors=[floats(0, "VEC3"), floats(2, "VEC3")],
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}}, {"attributes": {"POSITION": 0, "COLOR_0": 1}}]}],
    )
    np.testing.assert_array_equal(mesh.look.vertex_colors[[0, 3]], [[255, 255, 255, 255], [255, 0, 0, 255]])


def test_json_gltf_takes_its_buffers_from_data_uris_or_from_beside_it() -> None:
    root, binary = triangle_gltf()
    root["buffers"] = [{"byteLength": 42, "uri": "./tree%20data.bin"}]
    outside = read(json.dumps(root).encode(), "gltf", companions={"tree data.bin": binary})
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    root["buffers"] = [{"byteLength": 42, "uri": uri}]
    inside = read(json.dumps(root).encode(), "gltf")
    np.testing.assert_array_equal(outside.vertices, inside.vertices)


def test_draco_is_decoded(rng) -> None:
    mesh = trunk_and_crown(rng)
    stream = DracoPy.encode(
        mesh.vertices[:, [0, 2, 1]] * [1, 1, -1],
        mesh.faces,
        quantization_bits=20,
        preserve_order=True,
        tex_coord=mesh.look.uv.astype(np.float64),
    )
    decoded = DracoPy.decode(stream)
    names = {0: "POSITION", 3: "TEXCOORD_0"}  # draco's attribute types
    identities = {names[int(a["attribute_type"])]: int(a["unique_id"]) for a in decoded.attributes}
    primitive = {
        "attributes": {"POSITION": 0, "TEXCOORD_0": 2},
        "indices": 1,
        "extensions": {"KHR_draco_mesh_compression": {"bufferView": 2, "attributes": identities}},
    }
    result = with_data(
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
    np.testing.assert_allclose(result.vertices, mesh.vertices, atol=1e-4)
    np.testing.assert_array_equal(result.faces, mesh.faces)
    np.testing.assert_allclose(result.look.uv, mesh.look.uv, atol=1e-2)


def test_what_names_an_image_that_was_not_sent_is_not_written_back() -> None:
    root, binary = triangle_gltf(
        materials=[
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}},
                "extensions": {"KHR_materials_x": {"xTexture": {"index": 0}}},
            }
        ],
        textures=[{"source": 0}, {"source": 1}],
        images=[{"uri": "gone.png"}, {"uri": "here.png"}],
    )
    root["meshes"][0]["primitives"][0]["material"] = 0
    mesh = read(gltf_bytes(root, binary), "glb", companions={"here.png": image_bytes()})
    written = json.loads(mesh.gltf.document)
    assert [("uri" in image, "bufferView" in image) for image in written["images"]] == [(False, True)] * 2
    assert written["materials"] == [
        {"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 1}}, "extensions": {"KHR_materials_x": {}}}
    ]
    assert "texture-missing" in [warning.code for warning in mesh.warnings]


def test_coarser_levels_of_a_file_are_mentioned() -> None:
    nodes = [{"mesh": 0, "extensions": {"MSFT_lod": {"ids": [1]}}}, {"mesh": 0, "name": "coarse"}]
    mesh = read_gltf(nodes=nodes, extensionsUsed=["MSFT_lod"])
    assert "levels-left-out" in [warning.code for warning in mesh.warnings]
    assert not can_carry_joints(mesh.gltf)
