"""A GLB that is animated differs from the file that was sent by morph targets, weights and one animation only."""

import base64
import copy
import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import DracoPy
import numpy as np
import pytest
from typer.testing import CliRunner

from dynamictree.cli import app
from dynamictree.commands.input_files import load_mesh
from dynamictree.formats.gltf.motion import MorphOptions, write_motion_glb
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from dynamictree.spectrum import to_motion
from tests.formats import artists
from tests.formats.artists import Artist, Document, document_of
from tests.formats.looks import (
    MODELS,
    UNCHANGED,
    animated,
    animated_twin,
    coefficients_of,
    floats,
    looks,
    played,
    through_the_parser,
    without_motion,
)
from tests.js_tools import validated

SAMPLES = Path(os.environ.get("DYNAMICTREE_SAMPLES", "/nowhere"))


@pytest.mark.parametrize("model", UNCHANGED)
def test_a_model_of_an_artist_differs_by_its_motion_only(model: Callable[[], Artist]) -> None:
    glb = model().glb()
    assert without_motion(animated_twin(glb)) == looks(document_of(glb))


def test_instances_become_nodes_and_all_else_stays() -> None:
    glb = artists.instanced().glb()
    before, after = looks(document_of(glb)), without_motion(animated_twin(glb))
    (above,) = before.pop("nodes")
    node, *places = after.pop("nodes")
    mesh, extension = above.pop("mesh"), above.pop("extensions")
    assert node.pop("children") == [1, 2, 3]
    assert node == above
    assert all(place.pop("mesh") == mesh for place in places)
    before["extensionsUsed"].remove(*extension)
    assert after == before


def test_draco_streams_become_accessors_and_all_else_stays() -> None:
    artist = artists.compressed()
    document = animated_twin(artist.glb())
    before, after = looks(document_of(artist.glb())), without_motion(document)
    (old,), (new,) = (root.pop("nodes")[0]["mesh"]["primitives"] for root in (before, after))
    extension = old.pop("extensions")["KHR_draco_mesh_compression"]
    stream = DracoPy.decode(document_of(artist.glb()).bytes_of(extension["bufferView"]))
    (primitive,) = document.root["meshes"][0]["primitives"]
    for name, identity in extension["attributes"].items():
        decoded = stream.get_attribute_by_unique_id(identity)["data"]
        np.testing.assert_array_equal(document.accessor(primitive["attributes"][name]), decoded)
        accessor = document.root["accessors"][primitive["attributes"][name]]
        if "min" in accessor:
            np.testing.assert_array_equal(accessor["min"], decoded.min(axis=0))
            np.testing.assert_array_equal(accessor["max"], decoded.max(axis=0))
    np.testing.assert_array_equal(document.accessor(primitive["indices"]).reshape(-1, 3), stream.faces)
    assert new.pop("material") == old.pop("material")
    assert before.pop("extensionsRequired") == ["KHR_draco_mesh_compression"]
    before["extensionsUsed"].remove("KHR_draco_mesh_compression")
    assert after == before


@pytest.mark.parametrize("model", MODELS)
def test_a_model_of_an_artist_moves_as_its_mesh_does(model: Callable[[], Artist]) -> None:
    mesh = read_mesh(io.BytesIO(model().glb()), file_type="glb")
    coefficients = coefficients_of(mesh)
    document = animated(through_the_parser(mesh), coefficients)
    motion = to_motion(coefficients, 10)
    bloom = played_default(document, mesh)
    for key in (0, 3, 10):
        gap = np.abs(played(document, key) - bloom - mesh.vertices - motion[key % 10]).max()
        assert gap < 3e-6 * np.abs(mesh.vertices).max()


def played_default(document: Document, mesh: TriangleMesh) -> np.ndarray | float:
    """What a morph target of the file's own adds, which its default weight keeps on."""
    primitive = document.root["meshes"][0]["primitives"][0]
    if "weights" not in document.root["meshes"][0]:
        return 0.0
    x, y, z = 0.5 * floats(document, primitive["targets"][0]["POSITION"]).T
    return np.stack([x, -z, y], axis=1)


@pytest.mark.parametrize("model", UNCHANGED)
def test_a_model_of_an_artist_is_converted_to_itself(model: Callable[[], Artist], tmp_path: Path) -> None:
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
    mesh = read_mesh(io.BytesIO(json.dumps(root).encode()), file_type="gltf", companions=files)
    after, before = without_motion(animated(mesh, coefficients_of(mesh))), looks(inside)
    for image in after["images"]:
        image["name"] = None
    assert after == before


def test_a_model_that_is_said_to_lie_is_turned_and_scaled_by_one_node() -> None:
    mesh = read_mesh(io.BytesIO(artists.wooded().glb()), file_type="glb", reading=Reading(up_axis="-X", unit_m=0.01))
    coefficients = coefficients_of(mesh)
    document = animated(mesh, coefficients)
    moved = mesh.vertices + to_motion(coefficients, 10)[3]
    np.testing.assert_allclose(played(document, 3), moved, atol=3e-6 * np.abs(mesh.vertices).max())
    (root,) = document.root["scenes"][0]["nodes"]
    assert document.root["nodes"][root]["children"] == [0]


def test_parts_that_stand_still_are_as_they_were() -> None:
    mesh = read_mesh(io.BytesIO(artists.wooded().glb()), file_type="glb")
    coefficients = coefficients_of(mesh)
    coefficients[:48] = 0  # trunk and crown; the twig moves
    primitives = animated(mesh, coefficients).root["meshes"]
    assert ["targets" in mesh["primitives"][0] for mesh in primitives] == [False, True]


def test_an_own_animation_is_mentioned_and_stays_after_ours() -> None:
    mesh = read_mesh(io.BytesIO(artists.skinned().glb()), file_type="glb")
    assert [warning.code for warning in mesh.warnings] == ["animations-ignored"]
    names = [entry["name"] for entry in animated(mesh, coefficients_of(mesh)).root["animations"]]
    assert names == ["sway", "nod"]


def test_what_is_too_much_to_return_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynamictree.formats.gltf.source.MAX_SOURCE_PRIMITIVES", 2)
    mesh = read_mesh(io.BytesIO(artists.wooded().glb()), file_type="glb")
    assert mesh.gltf is None
    assert "looks-reduced" in [warning.code for warning in mesh.warnings]
    leaf = animated(mesh, coefficients_of(mesh)).root["materials"][1]
    assert (leaf["alphaMode"], leaf["doubleSided"]) == ("BLEND", True)


def test_a_damaged_part_that_the_motion_needs_not_refuses_no_file() -> None:
    artist = artists.wooded()
    artist.root["images"].append({"uri": "data:image/png;base64,&"})
    mesh = read_mesh(io.BytesIO(artist.glb()), file_type="glb")
    assert "looks-reduced" in [warning.code for warning in mesh.warnings]


@pytest.mark.slow
def test_khronos_validator_finds_in_the_animated_what_it_finds_in_the_source(tmp_path: Path) -> None:
    paths = []
    for number, model in enumerate(MODELS):
        paths += [tmp_path / f"{number}-before.glb", tmp_path / f"{number}-after.glb"]
        paths[-2].write_bytes(model().glb())
        mesh = read_mesh(io.BytesIO(model().glb()), file_type="glb")
        with paths[-1].open("wb") as stream:
            write_motion_glb(
                mesh, coefficients_of(mesh), stream, num_frames=10, options=MorphOptions(with_normals=True)
            )
    issues = [(report["numErrors"], report["numWarnings"]) for report in validated(paths)]
    assert issues[1::2] == issues[::2]


SHARED = ["mesh/tree-lime.glb", "animated/AnimatedMorphSphere.glb"]
FOREIGN = ["mesh/bevy_palm_scene/PalmTree.gltf", "mesh/godot_tree/scene.gltf"]


@pytest.mark.parametrize("name", [*SHARED, *(f"../foreign/{name}" for name in FOREIGN)])
def test_a_model_of_the_samples_differs_by_its_motion_only(name: str) -> None:
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
    expected, after = looks(before), without_motion(animated(mesh, coefficients_of(mesh)))
    for animation in expected.get("animations", []):  # of own morph targets, which end
        assert {channel["target"]["path"] for channel in animation["channels"]} == {"weights"}
    expected.pop("animations", None)
    expected["asset"].pop("extras", None)
    assert after == expected
