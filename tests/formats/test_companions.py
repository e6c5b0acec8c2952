"""How files beside a model are found, and what is said of those that are not there."""

import io
import json
import re

import numpy as np
import pytest

from dynamictree.formats.companions import Companions, beside_model, find_companion, is_system_file
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.tensors.bundle import read_mesh_bundle, write_bundle
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats.meshes import gltf_bytes, image_bytes, triangle_gltf, written

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
        ("C:\\art\\b\\leaf.png", b"4"),  # the longest end that is shared decides
        ("../TEXTURES/my bark.PNG", b"2"),
        ("none.png", None),
        ("../..", None),
        ("", None),
    ],
)
def test_a_file_is_found_by_the_end_of_its_path(name: str, content: bytes | None) -> None:
    assert find_companion(name, FILES) == content


@pytest.mark.parametrize(
    ("sent", "named"),
    [
        ("Ba\u0308ume.png", "B\u00e4ume.png"),  # macOS takes accents apart
        ("B\u00e4ume.png", "Ba\u0308ume.png"),
        ("\u8449.png".encode("cp932").decode("cp437"), "\u8449.png"),  # a zip of Windows in Japanese, an MTL in UTF-8
        ("\u8449.png", "\u8449.png".encode("cp932").decode("latin-1")),  # the MTL in Shift-JIS
        ("\u8449.png".encode("gbk").decode("cp437"), "\u8449.png".encode("gbk").decode("latin-1")),
        ("B\u00e4ume.png".encode("cp850").decode("cp437"), "B\u00e4ume.png".encode("cp1252").decode("latin-1")),
        ("\u043a\u043e\u0440\u0430.png".encode("cp866").decode("cp437"), "\u043a\u043e\u0440\u0430.png"),
    ],
)
def test_a_name_in_another_code_page_is_the_same_name(sent: str, named: str) -> None:
    assert find_companion(named, {sent: b"1", "other.png": b"2"}) == b"1"


@pytest.mark.parametrize(
    ("name", "added"),
    [
        *((name, True) for name in ("__MACOSX/tree/._bark.png", "tree/.DS_Store", "._tree.obj", "a/._b/tree.obj")),
        *((name, True) for name in (".AppleDouble/tree.obj", ".Spotlight-V100/store.obj", ".Trashes/501/tree.obj")),
        *((name, True) for name in (".fseventsd/0.obj", ".TemporaryItems/t.obj", "tree/Icon\r", "__macosx/tree.obj")),
        *((name, True) for name in ("a/Thumbs.db", "ehthumbs.db", "photos\\desktop.ini", "$RECYCLE.BIN/S-1/tree.obj")),
        *((name, True) for name in ("a\\THUMBS.DB", ".directory", ".Trash-1000/files/tree.obj", ".nfs0000.obj")),
        *((name, True) for name in ("@eaDir/p1.jpg/SYNOPHOTO_THUMB_M.jpg",)),
        *((name, False) for name in ("./tree.obj", "../tree.obj", "tree v1.2/tree.obj", "thumbs/db.png")),
    ],
)
def test_what_operating_systems_add_is_known(name: str, added: bool) -> None:
    assert is_system_file(name) == added


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
    root["meshes"][0]["primitives"][0]["material"] = 0
    return json.dumps(root).encode(), binary


def read(content: bytes, files: dict[str, bytes]) -> TriangleMesh:
    return read_mesh(io.BytesIO(content), file_type="gltf", companions=files)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_a_gltf_with_folders_is_read_with_its_textures(kind: str) -> None:
    content, binary = textured(f"textures/bark.{kind.lower()}")
    mesh = read(content, {"scene.bin": binary, f"textures/bark.{kind.lower()}": image_bytes(kind)})
    assert mesh.look.materials[0].texture_png.startswith(b"\x89PNG")
    assert mesh.warnings == ()


def test_a_missing_texture_is_a_warning_with_its_name() -> None:
    content, binary = textured("textures/bark%20old.png")
    mesh = read(content, {"scene.bin": binary})
    assert mesh.look.materials[0].texture_png is None
    assert [(warning.code, "'textures/bark old.png'" in warning.message) for warning in mesh.warnings] == [
        ("texture-missing", True)
    ]
    assert read_mesh_bundle(io.BytesIO(written(write_bundle, mesh))).warnings == mesh.warnings


@pytest.mark.parametrize(
    ("scale", "unit_m", "proposal"),
    [
        (2470.0, None, [r"24\.7 m in centimetres \(unit_m 0\.01\)"]),
        (0.01, None, ["unit_m"]),
        (10.0, None, []),
        (2470.0, 1.0, []),
    ],
)
def test_a_size_that_trees_do_not_have_is_doubted(scale: float, unit_m: float | None, proposal: list[str]) -> None:
    root, binary = triangle_gltf()
    binary = (np.frombuffer(binary[:36], np.float32) * np.float32(scale)).tobytes() + binary[36:]
    mesh = read_mesh(io.BytesIO(gltf_bytes(root, binary)), file_type="glb", reading=Reading(unit_m=unit_m))
    assert [warning.code for warning in mesh.warnings] == ["size-doubtful"] * len(proposal)
    assert all(re.search(text, warning.message) for text, warning in zip(proposal, mesh.warnings, strict=True))


def test_a_companion_is_of_a_kind_that_a_mesh_names_and_lies_beside_it_or_below_and_nowhere_else(tmp_path) -> None:
    model = tmp_path / "model"
    (model / "textures").mkdir(parents=True)
    (model / "folder.png").mkdir()
    for name in ("tree.gltf", "tree.mtl", "notes.txt", "textures/bark.PNG", "../secret.png"):
        (model / name).write_bytes(name.encode())
    (model / "link.png").symlink_to(tmp_path / "secret.png")
    (model / "textures" / "up.png").symlink_to(tmp_path / "secret.png")
    companions = Companions(model / "tree.gltf")
    (model / "textures" / "._bark.png").write_bytes(b"Finder's")
    assert dict(companions) == {"tree.mtl": b"tree.mtl", "textures/bark.PNG": b"textures/bark.PNG"}
    assert "textures/bark.PNG" in companions
    assert len(companions) == 2
    for name in ("../secret.png", str(tmp_path / "secret.png"), "textures/up.png", "textures/none.png", "textures"):
        assert name not in companions
