"""How files beside a model are found, and what is said of those that are not there."""

import io
import json
import re

import numpy as np
import pytest

from dynamictree.errors import FormatError
from dynamictree.formats.companions import beside_model, find_companion
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.tensors.mesh_bundle import read_mesh_bundle, write_mesh_bundle
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats.meshes import image_bytes, triangle_gltf

FILES = {"scene.bin": b"1", "textures/My Bark.png": b"2", "a/leaf.png": b"3", "b/leaf.png": b"4"}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scene.bin", b"1"),
        ("./scene.bin", b"1"),
        ("textures/My%20Bark.png", b"2"),
        ("textures\\My Bark.png", b"2"),
        ("C:\\art\\my bark.png", b"2"),  # a path of the artist's machine: the base name is unique
        ("leaf.png", None),  # two of that name
        ("b/leaf.png", b"4"),
        ("none.png", None),
        ("", None),
    ],
)
def test_a_file_is_found_by_its_path_or_else_by_a_unique_name(name: str, content: bytes | None) -> None:
    assert find_companion(name, FILES) == content


def test_paths_in_an_upload_count_from_the_model_s_folder() -> None:
    files = {"tree/textures/bark.png": b"1", "tree/scene.bin": b"2", "licence.txt": b"3"}
    assert beside_model("tree/scene.gltf", files) == {"textures/bark.png": b"1", "scene.bin": b"2", "licence.txt": b"3"}


def textured(uri: str, **texture: object) -> tuple[bytes, bytes]:
    root, binary = triangle_gltf(
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        textures=[{"source": 0, **texture}],
        images=[{"uri": uri}],
        buffers=[{"byteLength": 42, "uri": "scene.bin"}],
    )
    root["meshes"][0]["primitives"][0]["material"] = 0  # type: ignore[index]
    return json.dumps(root).encode(), binary


def read(content: bytes, files: dict[str, bytes]) -> TriangleMesh:
    return read_mesh(io.BytesIO(content), file_type="gltf", companions=files)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_a_gltf_with_folders_is_read_with_its_textures(kind: str) -> None:
    content, binary = textured(f"textures/bark.{kind.lower()}")
    mesh = read(content, {"scene.bin": binary, f"textures/bark.{kind.lower()}": image_bytes(kind)})
    assert mesh.materials[0].texture_png is not None
    assert mesh.warnings == ()


def test_a_missing_texture_is_a_warning_with_its_name() -> None:
    content, binary = textured("textures/bark%20old.png")
    mesh = read(content, {"scene.bin": binary})
    assert mesh.materials[0].texture_png is None
    assert [(warning.code, "'textures/bark old.png'" in warning.message) for warning in mesh.warnings] == [
        ("texture-missing", True)
    ]
    stream = io.BytesIO()
    write_mesh_bundle(mesh, stream)
    assert read_mesh_bundle(io.BytesIO(stream.getvalue())).warnings == mesh.warnings


def test_a_missing_buffer_is_still_an_error() -> None:
    content, _ = textured("bark.png")
    with pytest.raises(FormatError, match=r"'scene\.bin' outside itself"):
        read(content, {"bark.png": image_bytes()})


@pytest.mark.parametrize(
    ("scale", "unit_m", "proposal"),
    [
        (2470.0, None, r"centimetres, set unit_m to 0\.01 \(24\.7 m\)"),
        (0.01, None, "unit_m"),
        (10.0, None, None),
        (2470.0, 1.0, None),
    ],
)
def test_a_size_that_trees_do_not_have_is_doubted(scale: float, unit_m: float | None, proposal: str | None) -> None:
    root, binary = triangle_gltf(buffers=[{"byteLength": 42, "uri": "scene.bin"}])
    binary = (np.frombuffer(binary[:36], np.float32) * np.float32(scale)).tobytes() + binary[36:]
    mesh = read_mesh(
        io.BytesIO(json.dumps(root).encode()),
        file_type="gltf",
        reading=Reading(unit_m=unit_m),
        companions={"scene.bin": binary},
    )
    if proposal is None:
        assert mesh.warnings == ()
    else:
        assert [warning.code for warning in mesh.warnings] == ["size-doubtful"]
        assert re.search(proposal, mesh.warnings[0].message)
