"""glTF and GLB: parts, materials, placed and instanced nodes, accessors, textures, Draco."""

import base64
import json
from collections.abc import Callable

import numpy as np
import pytest

from dynamictree.color import linear_to_srgb
from dynamictree.formats.gltf.template import can_carry_joints
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats import artists
from tests.formats.artists import Artist, document_of
from tests.formats.looks import MODELS, standing
from tests.formats.meshes import gltf_bytes, image_bytes, read, triangle_gltf

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], np.float32)  # corners of triangle_gltf, +Z up


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


@pytest.mark.parametrize(
    ("reading", "corners", "source"),
    [
        (Reading(), CORNERS, ("+Y", 1.0)),
        (Reading(up_axis="+Z", unit_m=0.01), [[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]], ("+Z", 0.01)),
    ],
)
def test_gltf_is_in_metres_and_y_up_unless_said_otherwise(reading: Reading, corners: object, source: object) -> None:
    mesh = read(gltf_bytes(*triangle_gltf()), "glb", reading=reading)
    np.testing.assert_allclose(mesh.vertices, corners)
    assert (mesh.source.up_axis, mesh.source.scale) == source


@pytest.mark.parametrize("model", MODELS[:5])  # the others are instanced and compressed
def test_vertices_stand_where_nodes_joints_and_morph_weights_put_them(model: Callable[[], Artist]) -> None:
    glb = model().glb()
    np.testing.assert_allclose(read(glb, "glb").vertices, standing(document_of(glb), lambda *_: 0.0), atol=1e-5)


def test_a_draco_stream_is_the_part_that_it_was_made_of() -> None:
    packed, plain = (read(model().glb(), "glb") for model in (artists.compressed, artists.plain))
    np.testing.assert_allclose(packed.vertices, plain.vertices, atol=1e-3)
    np.testing.assert_array_equal(packed.faces, plain.faces)
    np.testing.assert_allclose(packed.look.normals, plain.look.normals, atol=1e-2)
    stored = document_of(artists.plain().glb()).accessor(5)  # COLOR_0, which glTF has in linear light
    np.testing.assert_allclose(plain.look.vertex_colors[:, :3], 255 * linear_to_srgb(stored[:, :3] / 255), atol=0.51)
    np.testing.assert_array_equal(plain.look.vertex_colors[:, 3], stored[:, 3])


def test_a_node_s_matrix_is_stored_by_columns_and_a_mirror_keeps_the_outside_outside() -> None:
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1]
    np.testing.assert_allclose(read_gltf(nodes=[{"mesh": 0, "matrix": matrix}]).vertices[0], [7, -9, 8])
    np.testing.assert_array_equal(read_gltf(nodes=[{"mesh": 0, "scale": [-1, 1, 1]}]).faces, [[2, 1, 0]])


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


@pytest.mark.parametrize(
    "changes",
    [
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]},  # no indices: vertices in their order
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode} for mode in (0, 1, 4)]}]},
        {"nodes": [{"mesh": 0.0}]},
        {"extensionsRequired": ["KHR_materials_unlit", "KHR_lights_punctual"]},  # both affect only the look
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
