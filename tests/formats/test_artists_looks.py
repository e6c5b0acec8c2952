"""A GLB that is animated differs from the file that was sent by morph targets, weights and one animation only."""

import base64
import copy
import io
import json
import os
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
import OpenEXR
import pytest

from dynamictree.commands.convert import write_mesh_file
from dynamictree.commands.source import load_mesh
from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.motion.vertex_texture import iter_vertex_texture_zip
from dynamictree.formats.tensors.mesh_bundle import read_mesh_bundle, write_mesh_bundle
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from dynamictree.spectrum import to_motion
from tests.formats import artists
from tests.formats.artists import Artist, Document, document_of

ROOT = Path(__file__).parents[2]
JS_TOOLS = ROOT / ".cache" / "js-tools"
SAMPLES = Path(os.environ.get("DYNAMICTREE_SAMPLES", "/nowhere"))
UNCHANGED = [artists.wooded, artists.repeated, artists.skinned, artists.morphing, artists.quantised]
MODELS = [*UNCHANGED, artists.instanced, artists.compressed]


def coefficients_of(mesh: TriangleMesh, num_frequencies: int = 4) -> np.ndarray:
    rng = np.random.default_rng(0)
    parts = rng.normal(0, 0.02 * mesh.height_m, (mesh.num_vertices, num_frequencies, 6)).astype(np.float32)
    return parts.view(np.complex64)


def animated(mesh: TriangleMesh, coefficients: np.ndarray) -> Document:
    stream = io.BytesIO()
    write_motion_glb(mesh, coefficients, stream, num_frames=10)
    return document_of(stream.getvalue())


def looks(document: Document) -> dict[str, Any]:
    """All that the document shows, without indices: content in the place of each accessor, view and image."""
    root = copy.deepcopy(document.root)

    def values(index: int) -> tuple[Any, ...]:
        entry = root["accessors"][index]
        described = {name: value for name, value in entry.items() if name not in ("bufferView", "byteOffset")}
        return described, document.accessor(index).tobytes() if "bufferView" in entry else b""

    for mesh in root["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["attributes"] = {name: values(index) for name, index in primitive["attributes"].items()}
            if "indices" in primitive:
                primitive["indices"] = values(primitive["indices"])
            primitive["targets"] = [{n: values(i) for n, i in t.items()} for t in primitive.get("targets", [])]
    for node in root["nodes"]:
        if "mesh" in node:
            node["mesh"] = root["meshes"][node["mesh"]]
    for skin in root.get("skins", []):
        skin["inverseBindMatrices"] = values(skin["inverseBindMatrices"])
    for animation in root.get("animations", []):
        for sampler in animation["samplers"]:
            sampler |= {name: values(sampler[name]) for name in ("input", "output")}
    for index, image in enumerate(root.get("images", [])):
        content = document.image(index)
        uri = image.pop("uri", None)
        image |= {"content": content, "name": image.get("name", uri)}
        image.pop("bufferView", None)
        image.pop("mimeType", None)
    for name in ("meshes", "accessors", "bufferViews", "buffers"):
        root.pop(name, None)
    return root


def without_motion(document: Document) -> dict[str, Any]:
    """Its looks, less what animating added."""
    root = looks(document)
    facts = root["asset"].pop("extras")
    animations = root.pop("animations")
    assert animations[0]["name"] == "sway"
    if animations[1:]:
        root["animations"] = animations[1:]
    for node in root["nodes"]:
        mesh = node.get("mesh")
        if mesh is None or len(mesh["primitives"][0]["targets"]) < facts["num_targets"]:
            continue
        for primitive in mesh["primitives"]:
            del primitive["targets"][-facts["num_targets"] :]
        if "weights" in mesh:
            del mesh["weights"][-facts["num_targets"] :]
        if "targetNames" in mesh.get("extras", {}):
            del mesh["extras"]["targetNames"][-facts["num_targets"] :]
    return root


def played(document: Document, key: int) -> np.ndarray:
    """Vertices of the scene at a key of the first animation, +Z up, parents before children."""
    root = document.root
    own = {}
    for channel in root["animations"][0]["channels"]:
        sampler = root["animations"][0]["samplers"][channel["sampler"]]
        keys = document.accessor(sampler["output"]).reshape(root["accessors"][sampler["input"]]["count"], -1)
        own[channel["target"]["node"]] = keys[key]

    def moved(node: int, primitive: dict[str, Any]) -> np.ndarray:
        targets = zip(own[node], primitive["targets"], strict=True)
        return sum(weight * floats(document, target["POSITION"]) for weight, target in targets)

    return standing(document, moved)


def standing(document: Document, moved: Callable[[int, dict[str, Any]], np.ndarray | float]) -> np.ndarray:
    """Vertices of the scene with what is added to the positions of each node's primitives, +Z up."""
    root = document.root
    world: dict[int, np.ndarray] = {}

    def visit(index: int, above: np.ndarray) -> None:
        world[index] = above @ local_matrix(root["nodes"][index])
        for child in root["nodes"][index].get("children", []):
            visit(child, world[index])

    for first in root["scenes"][root["scene"]]["nodes"]:
        visit(first, np.eye(4))
    vertices = []
    for index, matrix in world.items():
        node = root["nodes"][index]
        if "mesh" not in node:
            continue
        for primitive in root["meshes"][node["mesh"]]["primitives"]:
            if primitive.get("mode", 4) != 4:
                continue
            position = floats(document, primitive["attributes"]["POSITION"]) + moved(index, primitive)
            place = np.tile(matrix[:3], (len(position), 1, 1))
            if "skin" in node:
                skin = root["skins"][node["skin"]]
                bind = document.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
                joints = np.stack([world[j] for j in skin["joints"]]) @ bind
                chosen = document.accessor(primitive["attributes"]["JOINTS_0"])
                weights = document.accessor(primitive["attributes"]["WEIGHTS_0"])
                place = np.einsum("nj,njab->nab", weights, joints[chosen])[:, :3]
            vertices.append(np.einsum("nij,nj->ni", place[:, :, :3], position) + place[:, :, 3])
    x, y, z = np.concatenate(vertices).T
    return np.stack([x, -z, y], axis=1)


def floats(document: Document, index: int) -> np.ndarray:
    stored = document.accessor(index)
    return stored / np.iinfo(stored.dtype).max if stored.dtype.kind == "i" else stored.astype(np.float64)


def local_matrix(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) + 2 * w * cross + 2 * cross @ cross) * node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def through_the_parser(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh as a job's worker gets it."""
    stream = io.BytesIO()
    write_mesh_bundle(mesh, stream)
    return read_mesh_bundle(io.BytesIO(stream.getvalue()), with_source=True)


def animated_twin(glb: bytes) -> Document:
    mesh = through_the_parser(read_mesh(io.BytesIO(glb), file_type="glb"))
    return animated(mesh, coefficients_of(mesh))


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


def vertex_texture(mesh: TriangleMesh, frames: np.ndarray) -> tuple[dict[str, Any], Document, np.ndarray]:
    """What `vat.json` says, the GLB at rest, and the texels [height, width, 3]."""
    chunks = iter_vertex_texture_zip(mesh, iter(frames), num_frames=len(frames), fps=24.0, loop=True)
    archive = zipfile.ZipFile(io.BytesIO(b"".join(chunks)))
    with tempfile.TemporaryDirectory() as folder:
        picture = OpenEXR.File(archive.extract("displacement.exr", folder)).channels()["RGB"].pixels
    return json.loads(archive.read("vat.json")), document_of(archive.read("tree.glb")), picture.astype(np.float64)


def shaded(facts: dict[str, Any], document: Document, texels: np.ndarray, frame: int) -> np.ndarray:
    """Vertices of the scene as a vertex shader places them."""

    def moved(_: int, primitive: dict[str, Any]) -> np.ndarray:
        u, v = document.accessor(primitive["attributes"][facts["lookup_attribute"]]).T
        row = np.floor(v * facts["height"]).astype(int) + frame * facts["rows_per_frame"]
        return texels[row, np.floor(u * facts["width"]).astype(int)]

    return standing(document, moved)


@pytest.mark.parametrize("model", MODELS)
def test_a_vertex_texture_moves_a_model_of_an_artist_as_its_mesh(model: Callable[[], Artist]) -> None:
    mesh = read_mesh(io.BytesIO(model().glb()), file_type="glb")
    frames = to_motion(coefficients_of(mesh), 5)
    facts, document, texels = vertex_texture(through_the_parser(mesh), frames)
    still = standing(document, lambda node, primitive: 0.0)
    for number in (0, 3):
        gap = np.abs(shaded(facts, document, texels, number) - still - frames[number]).max()
        assert 0 < gap < np.sqrt(3) * facts["half_float_error_m"] + 3e-6 * np.abs(mesh.vertices).max()
    assert facts["half_float_error_m"] < 3e-3 * np.abs(frames).max()


@pytest.mark.parametrize("model", UNCHANGED)
def test_a_vertex_texture_adds_nothing_but_its_lookup(model: Callable[[], Artist]) -> None:
    glb = model().glb()
    mesh = through_the_parser(read_mesh(io.BytesIO(glb), file_type="glb"))
    facts, document, _ = vertex_texture(mesh, to_motion(coefficients_of(mesh), 2))
    before, after = looks(document_of(glb)), looks(document)
    number = int(facts["lookup_attribute"].removeprefix("TEXCOORD_"))
    for old, new in zip(before["nodes"], after["nodes"], strict=True):
        for plain, own in zip(*(node.get("mesh", {}).get("primitives", []) for node in (old, new)), strict=True):
            if facts["lookup_attribute"] not in own["attributes"]:
                continue  # neither points nor lines move
            for index in range(number + 1):
                if f"TEXCOORD_{index}" not in plain["attributes"]:
                    own["attributes"].pop(f"TEXCOORD_{index}")
    assert after == before


def test_a_model_in_units_that_halves_do_not_hold_is_written_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynamictree.formats.motion.vertex_texture._SMALLEST_UNIT", 1e3)
    mesh = read_mesh(io.BytesIO(artists.wooded().glb()), file_type="glb")
    frames = to_motion(coefficients_of(mesh), 2)
    facts, document, texels = vertex_texture(mesh, frames)
    assert [node["name"] for node in document.root["nodes"]] == ["tree"]
    moved = shaded(facts, document, texels, 1)[: mesh.num_vertices]  # each primitive has all of them
    assert np.abs(moved - mesh.vertices - frames[1]).max() < 3e-3


@pytest.mark.parametrize("model", UNCHANGED)
def test_a_model_of_an_artist_is_converted_to_itself(model: Callable[[], Artist], tmp_path: Path) -> None:
    glb = model().glb()
    write_mesh_file(read_mesh(io.BytesIO(glb), file_type="glb"), tmp_path / "tree.glb")
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
    assert mesh.source_gltf is None
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
    """Needs `make js-tools`."""
    if not (JS_TOOLS / "node_modules" / "gltf-validator").exists() or shutil.which("node") is None:
        pytest.skip("gltf-validator is not there: make js-tools, with node and npm")
    paths = []
    for number, model in enumerate(MODELS):
        paths += [tmp_path / f"{number}-before.glb", tmp_path / f"{number}-after.glb"]
        paths[-2].write_bytes(model().glb())
        mesh = read_mesh(io.BytesIO(model().glb()), file_type="glb")
        with paths[-1].open("wb") as stream:
            write_motion_glb(mesh, coefficients_of(mesh), stream, num_frames=10, with_normals=True)
    command = ["node", str(ROOT / "tests" / "js" / "validate_gltf.cjs"), str(JS_TOOLS), *map(str, paths)]
    reports = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    issues = [(report["numErrors"], report["numWarnings"]) for report in reports]
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
