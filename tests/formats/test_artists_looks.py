"""A GLB that moves is the file that was sent, with joints and one animation."""

import base64
import copy
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from typer.testing import CliRunner

from dynamictree.cli import app
from dynamictree.commands.input_files import load_mesh
from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.gltf.skin import Packing, write_skinned_glb
from dynamictree.formats.motion.vertex_texture import vertex_texture_files
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from dynamictree.skin import Skin
from dynamictree.spectrum import to_motion
from tests.formats import artists
from tests.formats.artists import Artist, Document, document_of
from tests.formats.looks import MODELS, coefficients_of, floats, looks, returned, standing, through_the_parser
from tests.formats.meshes import read, written
from tests.formats.stored import archive_of
from tests.formats.test_engine_files import SUMMARY, posed, random_skin
from tests.js_tools import validated

SAMPLES = Path(os.environ.get("DYNAMICTREE_SAMPLES", "/nowhere"))


@pytest.mark.parametrize("model", MODELS)
def test_a_skin_moves_a_model_of_an_artist_as_its_mesh(model: Callable[[], Artist], rng) -> None:
    mesh = through_the_parser(read(model().glb(), "glb"))
    skin = random_skin(mesh, rng)
    document = skinned(mesh, skin)
    for frame in (0, 3):
        moved = standing(at_key(document, frame), lambda node, primitive: 0.0)[: mesh.num_vertices]
        np.testing.assert_allclose(moved, posed(mesh, skin)[frame] + mesh.vertices, atol=2e-5 * mesh.height_m)


def test_a_model_with_places_of_its_own_becomes_one_mesh_with_its_materials(rng) -> None:
    glb = artists.instanced().glb()
    mesh = through_the_parser(read(glb, "glb"))
    after, before = skinned(mesh, random_skin(mesh, rng)).root, document_of(glb).root
    assert [node.get("name") for node in after["nodes"] if "mesh" in node] == ["tree"]
    assert after["materials"][1:] == before["materials"][1:]


def skinned(mesh: TriangleMesh, skin: Skin) -> Document:
    return document_of(written(write_skinned_glb, mesh, skin, SUMMARY, fps=24.0, packing=Packing(False, False)))


def at_key(document: Document, key: int) -> Document:
    """With the rotations of the first animation at a key."""
    still = Document(copy.deepcopy(document.root), document.buffers, {})
    animation = still.root["animations"][0]
    for channel in animation["channels"]:
        keys = floats(document, animation["samplers"][channel["sampler"]]["output"])
        still.root["nodes"][channel["target"]["node"]]["rotation"] = (keys[key] / np.linalg.norm(keys[key])).tolist()
    return still


@pytest.mark.parametrize("model", MODELS)
def test_a_model_of_an_artist_is_converted_to_itself(model: Callable[[], Artist], tmp_path) -> None:
    (tmp_path / "source.glb").write_bytes(glb := model().glb())
    converted = CliRunner().invoke(app, ["convert", str(tmp_path / "source.glb"), str(tmp_path / "tree.glb")])
    assert converted.exit_code == 0, converted.output
    assert looks(document_of((tmp_path / "tree.glb").read_bytes())) == looks(document_of(glb))


def test_files_beside_a_model_move_into_the_glb() -> None:
    glb = artists.wooded()
    inside = document_of(glb.glb())
    root = copy.deepcopy(glb.root)
    files = {"tree.bin": glb.binary}
    for index, image in enumerate(root["images"]):
        name = f"textures/{index}.{image['mimeType'][6:]}"
        files[name] = inside.image(index)
        del image["bufferView"], image["mimeType"]
        image["uri"] = name
    root["images"][0]["uri"] = "data:image/jpeg;base64," + base64.b64encode(inside.image(0)).decode()
    root["buffers"] = [{"byteLength": len(glb.binary), "uri": "tree.bin"}]
    mesh = read(json.dumps(root).encode(), "gltf", companions=files)
    after, before = looks(returned(mesh)), looks(inside)
    for image in after["images"]:
        image["name"] = None
    assert after == before


def test_a_model_that_is_said_to_lie_is_turned_and_scaled_by_one_node() -> None:
    mesh = read(artists.wooded().glb(), "glb", reading=Reading(up_axis="-X", unit_m=0.01))
    document = returned(mesh)
    places = standing(document, lambda node, primitive: 0.0)
    np.testing.assert_allclose(places, mesh.vertices, atol=3e-6 * np.abs(mesh.vertices).max())
    (root,) = document.root["scenes"][0]["nodes"]
    assert document.root["nodes"][root]["children"] == [0]


def test_parts_that_stand_still_are_as_they_were(rng) -> None:
    mesh = read(artists.wooded().glb(), "glb")
    skin = random_skin(mesh, rng)
    weights = skin.weights.copy()
    weights[:48] = (1, 0, 0, 0)  # trunk and crown hang on joint 0; the twig moves
    meshes = skinned(mesh, replace(skin, weights=weights)).root["meshes"]
    assert ["JOINTS_0" in mesh["primitives"][0]["attributes"] for mesh in meshes] == [False, True]


def test_an_own_animation_is_mentioned_and_stays_after_ours(rng) -> None:
    artist = artists.wooded()
    sampler = {"input": artist.accessor(np.float32([0, 1])), "output": artist.accessor(np.zeros((2, 3), np.float32))}
    channel = {"sampler": 0, "target": {"node": 3, "path": "translation"}}
    artist.add("animations", {"name": "nod", "samplers": [sampler], "channels": [channel]})
    mesh = read(artist.glb(), "glb")
    assert "animations-ignored" in [warning.code for warning in mesh.warnings]
    names = [entry["name"] for entry in skinned(mesh, random_skin(mesh, rng)).root["animations"]]
    assert names == ["sway", "nod"]


def test_what_is_too_much_to_return_is_said(monkeypatch) -> None:
    monkeypatch.setattr("dynamictree.formats.gltf.source.MAX_SOURCE_PRIMITIVES", 2)
    mesh = read(artists.wooded().glb(), "glb")
    assert mesh.gltf is None
    assert "looks-reduced" in [warning.code for warning in mesh.warnings]
    leaf = returned(mesh).root["materials"][1]
    assert (leaf["alphaMode"], leaf["doubleSided"]) == ("BLEND", True)


def test_a_damaged_part_that_the_motion_needs_not_refuses_no_file() -> None:
    artist = artists.wooded()
    artist.root["images"].append({"uri": "data:image/png;base64,&"})
    assert "looks-reduced" in [warning.code for warning in read(artist.glb(), "glb").warnings]


@pytest.mark.slow
@pytest.mark.parametrize("packing", [Packing(False, False), Packing(True, True)])
def test_khronos_validator_finds_no_fault_that_is_not_of_the_source(packing: Packing, tmp_path) -> None:
    paths = []
    for number, model in enumerate(MODELS):
        paths += [tmp_path / f"{number}-{name}.glb" for name in ("before", "skin", "targets")]
        paths[-3].write_bytes(model().glb())
        mesh = read(model().glb(), "glb")
        with paths[-2].open("wb") as stream:
            skin = random_skin(mesh, np.random.default_rng(0))
            write_skinned_glb(mesh, skin, SUMMARY, stream, fps=24.0, packing=packing)
        paths[-1].write_bytes(written(write_motion_glb, mesh, coefficients_of(mesh), num_frames=10))
    issues = [(report["numErrors"], report["numWarnings"]) for report in validated(paths)]
    assert all(skin in (source, (0, 0)) for source, skin in zip(issues[::3], issues[1::3], strict=True)), issues
    assert set(issues[2::3]) == {(0, 0)}


SHARED = ["mesh/tree-lime.glb", "animated/AnimatedMorphSphere.glb"]
FOREIGN = ["mesh/bevy_palm_scene/PalmTree.gltf", "mesh/godot_tree/scene.gltf"]


@pytest.mark.parametrize("name", [*SHARED, *(f"../foreign/{name}" for name in FOREIGN)])
def test_a_model_of_the_samples_is_returned(name: str) -> None:
    path = SAMPLES / name
    if not path.exists():
        pytest.skip(f"DYNAMICTREE_SAMPLES has no {name}")
    mesh = load_mesh(path)
    if path.suffix == ".glb":
        before = document_of(path.read_bytes())
    else:
        root = json.loads(path.read_text())
        files = {str(file.relative_to(path.parent)): file.read_bytes() for file in path.parent.rglob("*.*")}
        before = Document(root, [files[buffer["uri"]] for buffer in root["buffers"]], files)
    expected, after = looks(before), looks(returned(mesh))
    expected["asset"].pop("extras", None)
    after["asset"].pop("extras", None)
    assert after == expected


def vertex_texture(mesh: TriangleMesh, frames: np.ndarray) -> tuple[dict[str, Any], Document, np.ndarray]:
    """What `vat.json` says, the GLB at rest, and the texels [height, width, 3]."""
    archive = archive_of(vertex_texture_files(mesh, iter(frames), num_frames=len(frames), fps=24.0, loop=True))
    with tempfile.TemporaryDirectory() as folder:
        picture = OpenEXR.File(archive.extract("displacement.exr", folder)).channels()["RGB"].pixels
    return json.loads(archive.read("vat.json")), document_of(archive.read("tree-rest.glb")), picture.astype(np.float64)


@pytest.mark.parametrize("model", MODELS)
def test_a_vertex_texture_moves_a_model_of_an_artist_as_its_mesh(model: Callable[[], Artist]) -> None:
    mesh = through_the_parser(read(model().glb(), "glb"))
    frames = to_motion(coefficients_of(mesh), 5)
    facts, document, texels = vertex_texture(mesh, frames)

    def shaded(frame: int) -> np.ndarray:
        def moved(_: int, primitive: dict[str, Any]) -> np.ndarray:
            u, v = document.accessor(primitive["attributes"][facts["lookup_attribute"]]).T
            row = np.floor(v * facts["height"]).astype(int) + frame * facts["rows_per_frame"]
            return texels[row, np.floor(u * facts["width"]).astype(int)]

        return standing(document, moved)[: mesh.num_vertices]  # each primitive has all of them

    for number in (0, 3):
        gap = np.abs(shaded(number) - mesh.vertices - frames[number]).max()
        assert 0 < gap < np.sqrt(3) * facts["half_float_error_m"] + 3e-6 * np.abs(mesh.vertices).max()
    assert facts["half_float_error_m"] < 3e-3 * np.abs(frames).max()


def test_materials_are_as_the_source_has_them_but_where_a_texture_lies_otherwise() -> None:
    glb = artists.wooded().glb()
    mesh = through_the_parser(read(glb, "glb"))
    before, document = document_of(glb), vertex_texture(mesh, np.zeros((1, mesh.num_vertices, 3), np.float32))[1]
    bark, *others = document.root["materials"]
    assert others == before.root["materials"][1:]
    assert set(bark) == {"name", "pbrMetallicRoughness", "doubleSided"}  # whose texture the source turns
    assert document.root["textures"][:-1] == before.root["textures"]
    contents = [document.image(index) for index in range(len(document.root["images"]) - 1)]
    assert contents == [before.image(index) for index in range(len(contents))]
    assert set(document.root["extensionsUsed"]) == {"EXT_texture_webp", "KHR_materials_transmission"}
    assert looks(document)["materials"]
