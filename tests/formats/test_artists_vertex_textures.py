"""A vertex texture moves a model of an artist, and has its materials."""

import json
import tempfile
from collections.abc import Callable
from typing import Any

import numpy as np
import OpenEXR
import pytest

from dynamictree.formats.motion.vertex_texture import vertex_texture_files
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import to_motion
from tests.formats import artists
from tests.formats.artists import Artist, Document, document_of
from tests.formats.looks import MODELS, coefficients_of, looks, standing, through_the_parser
from tests.formats.meshes import read
from tests.formats.stored import archive_of


def vertex_texture(mesh: TriangleMesh, frames: np.ndarray) -> tuple[dict[str, Any], Document, np.ndarray]:
    """What `vat.json` says, the GLB at rest, and the texels [height, width, 3]."""
    archive = archive_of(vertex_texture_files(mesh, iter(frames), num_frames=len(frames), fps=24.0, loop=True))
    with tempfile.TemporaryDirectory() as folder:
        picture = OpenEXR.File(archive.extract("displacement.exr", folder)).channels()["RGB"].pixels
    return json.loads(archive.read("vat.json")), document_of(archive.read("tree.glb")), picture.astype(np.float64)


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
