"""A vertex texture moves a model of an artist, and changes nothing else in it."""

import io
import json
import tempfile
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import OpenEXR
import pytest

from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.motion.vertex_texture import iter_vertex_texture_zip
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import to_motion
from tests.formats import artists
from tests.formats.artists import Artist, Document, document_of
from tests.formats.looks import MODELS, UNCHANGED, coefficients_of, looks, standing, through_the_parser


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
