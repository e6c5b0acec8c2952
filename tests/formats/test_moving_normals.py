"""Normals that move: as targets of a GLB beside those of positions, and as a texture beside the vertex texture."""

import io
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from dynamictree.formats.gltf.motion import MorphOptions, ShadedMorphSummary, write_motion_glb
from dynamictree.formats.gltf.normals import angles_rad, iter_normals, turn_normals
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.motion.vertex_texture import iter_vertex_texture_zip
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import to_motion
from dynamictree.up_axis import up_rotation
from tests.formats import artists
from tests.formats.artists import Document, document_of
from tests.formats.looks import local_matrix
from tests.formats.meshes import trunk_and_crown

FRAMES = 20


def bending(mesh: TriangleMesh, slope: float) -> np.ndarray:
    """A sway across +Z that grows with the square of height, and its first overtone."""
    height = mesh.vertices[:, 2] - mesh.vertices[:, 2].min()
    coefficients = np.zeros((mesh.num_vertices, 4, 3), np.complex64)
    coefficients[:, 1, 0] = slope * height**2 / height.max()
    coefficients[:, 2, 1] = 0.3j * slope * height**2 / height.max()
    return coefficients


def animated(mesh: TriangleMesh, coefficients: np.ndarray) -> tuple[Document, ShadedMorphSummary]:
    stream = io.BytesIO()
    summary = write_motion_glb(mesh, coefficients, stream, num_frames=FRAMES, options=MorphOptions(with_normals=True))
    assert isinstance(summary, ShadedMorphSummary)
    return document_of(stream.getvalue()), summary


def played_normals(document: Document, node: int, matrix: np.ndarray, key: int) -> np.ndarray:
    """Of the first primitive of a node, +Z up, as an engine shades them."""
    root = document.root
    primitive = root["meshes"][root["nodes"][node]["mesh"]]["primitives"][0]
    sampler = root["animations"][0]["samplers"][0]
    weights = document.accessor(sampler["output"]).reshape(-1, len(primitive["targets"]))[key]
    normals = document.accessor(primitive["attributes"]["NORMAL"]).astype(np.float32)
    for weight, target in zip(weights, primitive["targets"], strict=True):
        normals = normals + weight * document.accessor(target["NORMAL"])
    return turn_normals(normals, up_rotation("+Y") @ matrix[:3, :3])


def test_targets_turn_normals_with_the_surface_and_say_how_well(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    coefficients = bending(mesh, 0.1)
    document, summary = animated(mesh, coefficients)
    truth = list(iter_normals(mesh, to_motion(coefficients, FRAMES)))
    angles = np.stack([angles_rad(played_normals(document, 0, np.eye(4), n), truth[n]) for n in range(FRAMES)])
    assert summary.normal_error_deg == pytest.approx(np.rad2deg(np.sqrt((angles**2).mean())), rel=1e-2)
    assert summary.max_normal_error_deg == pytest.approx(np.rad2deg(angles.max()), rel=1e-2)
    still = np.stack([angles_rad(truth[n], played_rest(document)) for n in range(FRAMES)])
    assert summary.still_normal_error_deg == pytest.approx(np.rad2deg(np.sqrt((still**2).mean())), rel=1e-2)
    assert summary.normal_error_deg < 0.1 * summary.still_normal_error_deg


def played_rest(document: Document) -> np.ndarray:
    (primitive,) = {p["attributes"]["NORMAL"]: p for p in document.root["meshes"][0]["primitives"]}.values()
    return document.accessor(primitive["attributes"]["NORMAL"]) @ up_rotation("+Y").T.astype(np.float32)


def test_a_turned_and_stretched_node_shades_as_the_mesh_does() -> None:
    mesh = read_mesh(io.BytesIO(artists.wooded().glb()), file_type="glb")
    coefficients = bending(mesh, 0.05)
    document, _ = animated(mesh, coefficients)
    matrix = local_matrix(document.root["nodes"][0]) @ local_matrix(document.root["nodes"][2])
    truth = list(iter_normals(mesh, to_motion(coefficients, FRAMES)))
    for key in (3, 11):
        played = played_normals(document, 2, matrix, key)
        assert angles_rad(played, truth[key][48:]).max() < 0.02
        assert angles_rad(played, mesh.look.normals[48:]).max() > 0.05  # type: ignore[index]


def test_the_normal_texture_has_the_normals_of_every_frame(rng: np.random.Generator, tmp_path: Path) -> None:
    mesh = trunk_and_crown(rng)
    motion = to_motion(bending(mesh, 0.1), FRAMES)
    normals = list(iter_normals(mesh, motion))
    chunks = iter_vertex_texture_zip(mesh, list(motion), num_frames=FRAMES, fps=24.0, loop=True, normals=normals)
    archive = zipfile.ZipFile(io.BytesIO(b"".join(chunks)))
    picture = OpenEXR.File(archive.extract("normal.exr", tmp_path)).channels()["RGB"].pixels.astype(np.float32)
    rows = len(picture) // FRAMES
    for number in (0, 7):
        texels = picture[number * rows : (number + 1) * rows].reshape(-1, 3)[: mesh.num_vertices]
        np.testing.assert_allclose(texels, normals[number] @ up_rotation("+Y").astype(np.float32), atol=1e-3)
