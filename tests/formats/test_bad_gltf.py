"""A glTF or GLB that breaks the rules is refused with what was found and what is allowed."""

import subprocess
import sys

import DracoPy
import numpy as np
import pytest

from dynamictree.errors import FormatError, InputError, MeshError
from tests.formats.meshes import gltf_bytes, read, triangle_gltf

Changes = dict[str, object]


def test_a_long_chain_of_nameless_nodes_is_read_in_linear_time() -> None:
    """In a process without the tests' checks of types: the square of 30,000 nodes would take it minutes."""
    count = 30_000
    nodes = [{"mesh": 0, "name": "leaf"}, *({"children": [index]} for index in range(count))]
    root, binary = triangle_gltf(nodes=nodes, scenes=[{"nodes": [count]}])
    program = (
        "import io, sys, time; from dynamictree.formats.mesh_file import read_mesh; content = sys.stdin.buffer.read()\n"
        "mesh = read_mesh(io.BytesIO(content), file_type='glb'); print(mesh.parts.names, time.process_time() < 20)"
    )
    call = [sys.executable, "-c", program]
    answer = subprocess.run(call, input=gltf_bytes(root, binary), capture_output=True, check=True)
    assert answer.stdout == b"('leaf',) True\n"


def test_instances_count_against_the_cap() -> None:
    nodes = [{"mesh": 0, "translation": [i, 0, 0]} for i in range(30)]
    accessors = [
        {"componentType": 5126, "count": 100_000, "type": "VEC3"},
        {"componentType": 5125, "count": 3, "type": "SCALAR"},
    ]
    root, binary = triangle_gltf(nodes=nodes, scenes=[{"nodes": list(range(30))}], accessors=accessors)
    with pytest.raises(MeshError, match="3,000,000 vertices"):
        read(gltf_bytes(root, binary), "glb")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"asset": {"version": "1.0"}}, "glTF 1.0"),
        ({"asset": 3}, "asset is 3"),
        ({"extensionsRequired": ["EXT_other_compression"]}, "EXT_other_compression"),
        ({"extensionsRequired": ["KHR_texture_basisu", "VENDOR_x"]}, "extension VENDOR_x"),
        ({"extensionsRequired": [3]}, "a string"),
        ({"meshes": []}, "has none"),
        ({"meshes": [{"primitives": []}]}, "no triangles"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]}]}, "no triangles"),
        ({"meshes": [{"primitives": [{"attributes": {}}]}]}, "no POSITION"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 1}}]}]}, "POSITION has 1 numbers"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": -1}}]}]}, "0 to 1"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 0}}]}]}, "TEXCOORD_0"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}}]}]}, "COLOR_0"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 0}]}]}, "no whole numbers"),
        ({"meshes": [{"primitives": 3}]}, "a list"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "reached twice"),
        ({"nodes": [{"children": [1]}, {"children": [0], "mesh": 0}]}, "reached twice"),
        ({"nodes": [{"mesh": 0, "rotation": [0, 0, 0, 0]}]}, "length 0"),
        ({"nodes": [{"mesh": 0, "translation": [0, 0]}]}, "3 are needed"),
        ({"nodes": [{"mesh": 0, "translation": [0, 0, "x"]}]}, "finite number"),
        ({"nodes": [{"mesh": 0, "skin": 0}], "skins": [{"joints": []}]}, "no joints"),
        ({"nodes": [{"mesh": 0, "skin": 0}], "skins": [{"joints": [0]}]}, "no JOINTS_0"),
        ({"nodes": [{"mesh": 0, "skin": 0}], "skins": [{"joints": [0], "inverseBindMatrices": 0}]}, "inverse bind"),
        ({"scenes": [{"nodes": [4]}]}, "0 to 0"),
        ({"buffers": [{"byteLength": 4300}]}, "says 4300 bytes"),
        ({"buffers": [{"byteLength": 42, "uri": "../../x"}]}, "outside itself"),
        ({"buffers": [{"byteLength": 42, "uri": "http://127.0.0.1/x"}]}, "outside itself"),
        ({"buffers": [{"byteLength": 42, "uri": "data:application/octet-stream;base64,***"}]}, "not base64"),
        ({"buffers": [{"byteLength": 42}, {"byteLength": 1}]}, "neither a uri"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 36}, {"byteLength": 6}]}, "names no buffer"),
        ({"bufferViews": [{"buffer": 0, "byteOffset": 40, "byteLength": 36}] * 2}, "ends at byte 76"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 30}] * 2}, "ends at byte 36"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 36, "byteStride": 4}] * 2}, "4 bytes apart"),
        ({"materials": [{"alphaMode": "GLOW"}]}, "GLOW"),
        ({"materials": [{}] * 10_001}, "10,001 materials; at most 10,000"),
    ],
)  # fmt: skip
def test_a_gltf_that_breaks_the_rules_is_refused(changes: Changes, message: str) -> None:
    root, binary = triangle_gltf(**changes)
    with pytest.raises(InputError, match=message):
        read(gltf_bytes(root, binary), "glb")


@pytest.mark.parametrize(
    ("accessor", "message"),
    [
        ({"type": "VEC9"}, "VEC9"),
        ({"componentType": 9}, "componentType is 9"),
        ({"count": 1 << 50}, "count is"),
        ({"byteOffset": 1}, "ends at byte 37"),
        ({"sparse": {"count": 4}}, "count is 4"),
        ({"sparse": {"count": 1, "indices": {"componentType": 5121}, "values": {}}}, "names no bufferView"),
        (
            {"sparse": {"count": 1, "indices": {"componentType": 5126, "bufferView": 0}, "values": {"bufferView": 0}}},
            "outside of its 3",
        ),
    ],
)
def test_an_accessor_that_breaks_the_rules_is_refused(accessor: Changes, message: str) -> None:
    root, binary = triangle_gltf()
    root["accessors"][0] |= accessor
    with pytest.raises(InputError, match=message):
        read(gltf_bytes(root, binary), "glb")


def test_skin_weights_that_name_no_joint_are_refused() -> None:
    attributes = {"POSITION": 0, "JOINTS_0": 0, "WEIGHTS_0": 0}
    root, binary = triangle_gltf(
        nodes=[{"mesh": 0, "skin": 0}], skins=[{"joints": [0]}], meshes=[{"primitives": [{"attributes": attributes}]}]
    )
    with pytest.raises(FormatError, match="joints beyond its 1"):
        read(gltf_bytes(root, binary), "glb")


@pytest.mark.parametrize(
    ("attributes", "message"),
    [({"TRANSLATION": 0, "SCALE": 2}, "different lengths"), ({"ROTATION": 0}, "3 numbers, not 4")],
)
def test_gpu_instances_that_do_not_agree_are_refused(attributes: Changes, message: str) -> None:
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    root, binary = triangle_gltf(nodes=[{"mesh": 0, "extensions": instancing}])
    root["accessors"].append({"componentType": 5126, "count": 2, "type": "VEC3"})
    with pytest.raises(FormatError, match=message):
        read(gltf_bytes(root, binary), "glb")


def test_a_draco_stream_that_is_none_is_refused() -> None:
    for extension, message in (
        ({}, "no POSITION|no bufferView"),
        ({"attributes": {}}, "no bufferView"),
        ({"bufferView": 0}, "Draco"),
    ):
        primitive = {"attributes": {"POSITION": 0}, "extensions": {"KHR_draco_mesh_compression": {"x": 1} | extension}}
        root, binary = triangle_gltf(meshes=[{"primitives": [primitive]}])
        with pytest.raises(FormatError, match=message):
            read(gltf_bytes(root, binary), "glb")


def test_a_draco_stream_of_points_is_refused() -> None:
    stream = DracoPy.encode(np.eye(3))
    root, binary = triangle_gltf(buffers=[{"byteLength": 44 + len(stream)}])
    root["bufferViews"].append({"buffer": 0, "byteOffset": 44, "byteLength": len(stream)})
    extension = {"bufferView": 2, "attributes": {"POSITION": 0}}
    primitive = {"attributes": {"POSITION": 0}, "extensions": {"KHR_draco_mesh_compression": extension}}
    root["meshes"] = [{"primitives": [primitive]}]
    with pytest.raises(FormatError, match="holds no mesh"):
        read(gltf_bytes(root, binary + b"\0\0" + stream), "glb")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"glTF" + b"\0" * 8, "truncated"),
        (b"glTF" + (1).to_bytes(4, "little") + b"\0" * 20, "GLB version 1"),
        (b"glTF" + (2).to_bytes(4, "little") + (999).to_bytes(4, "little") + b"\0" * 20, "says that it has 999"),
        (b"glTF" + (2).to_bytes(4, "little") + (28).to_bytes(4, "little") + b"\0" * 16, "no JSON chunk"),
        (b"glTF" + (2).to_bytes(4, "little") + (28).to_bytes(4, "little") + b"\xff" * 16, "ends at byte"),
        *((text, "JSON") for text in (b"{", b"[]", b"[" * 100_000, b'{"asset": nope}')),
    ],
)
def test_a_broken_container_or_json_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read(content, "gltf" if message == "JSON" else "glb")
