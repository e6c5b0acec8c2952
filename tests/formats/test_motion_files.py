"""PLY sequences, motion files and animated GLBs hold the motion that the spectrum tells."""

import io
import zipfile
from typing import Any

import numpy as np
import pygltflib
import pytest
import trimesh
from safetensors.numpy import load

from benchmarks._played import accessor, played_morphs
from dynamictree.formats.gltf.motion import MorphSummary, write_motion_glb
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.motion.ply_sequence import iter_ply_files
from dynamictree.formats.tensors.motion import write_motion
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from dynamictree.spectrum import from_motion, iter_motion, to_motion
from tests.formats.meshes import trunk_and_crown
from tests.formats.stored import archive_of


def sway(rng: np.random.Generator, mesh: TriangleMesh, num_frequencies: int = 16) -> np.ndarray:
    """A spectrum that falls with frequency and grows with height."""
    shape = (mesh.num_vertices, num_frequencies, 3)
    falling = 0.3 / (1 + np.arange(num_frequencies))[None, :, None] ** 1.5
    raw = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    return (0.1 * raw * falling * mesh.vertices[:, 2, None, None]).astype(np.complex64)


def animated(mesh: TriangleMesh, coefficients: np.ndarray, **options: Any) -> tuple[bytes, MorphSummary]:
    stream = io.BytesIO()
    summary = write_motion_glb(mesh, coefficients, stream, **options)
    return stream.getvalue(), summary


def played(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Times and displacement at every key, +Z up, as an engine adds targets up."""
    document = pygltflib.GLTF2().load_from_bytes(content)
    sampler = document.animations[0].samplers[0]
    assert sampler.interpolation == "LINEAR"
    assert all(one.targets == document.meshes[0].primitives[0].targets for one in document.meshes[0].primitives)
    return accessor(document, sampler.input)[:, 0], played_morphs(content)


@pytest.mark.parametrize("num_frames", [100, 61])
def test_31_targets_are_exact_at_the_keys_and_the_last_equals_the_first(
    rng: np.random.Generator, num_frames: int
) -> None:
    mesh = trunk_and_crown(rng)
    coefficients = sway(rng, mesh)
    content, summary = animated(mesh, coefficients, num_frames=num_frames)
    times, displacement = played(content)
    expected = to_motion(coefficients, num_frames)
    assert summary.num_targets == 31
    assert summary.num_keys == num_frames + 1 == len(times)
    assert summary.relative_error == 0
    np.testing.assert_allclose(displacement[:-1], expected, atol=2e-6 * np.abs(expected).max())
    np.testing.assert_array_equal(displacement[-1], displacement[0])
    np.testing.assert_allclose(times, np.arange(num_frames + 1) / 24, rtol=1e-6)


def test_weights_stay_in_the_range_of_a_slider(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    content, _ = animated(mesh, sway(rng, mesh))
    document = pygltflib.GLTF2().load_from_bytes(content)
    keys = accessor(document, document.animations[0].samplers[0].output)
    assert keys.min() >= 0
    assert keys.max() <= 1
    assert not document.meshes[0].weights, "all 0: the mesh at rest"
    result = read_mesh(io.BytesIO(content), file_type="glb")
    np.testing.assert_array_equal(result.vertices, mesh.vertices)


def test_a_whole_spectrum_of_an_even_period_is_exact_too(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    motion = rng.normal(size=(20, mesh.num_vertices, 3)).astype(np.float32)
    content, _ = animated(mesh, from_motion(motion, 11), num_frames=20)
    np.testing.assert_allclose(played(content)[1][:-1], motion, atol=1e-5)


def test_a_file_says_how_far_it_is_from_other_frames(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    coefficients = sway(rng, mesh)
    motion = to_motion(coefficients)
    content, summary = animated(mesh, coefficients[:, :4], truth=lambda: iter(motion))
    missing = played(content)[1][:-1] - motion
    assert summary.num_targets == 7
    assert summary.relative_error == pytest.approx(np.sqrt((missing**2).sum() / (motion**2).sum()), rel=1e-3)
    assert summary.rms_error_m == pytest.approx(np.sqrt((missing**2).sum(axis=2).mean()), rel=1e-3)
    assert summary.max_error_m == pytest.approx(np.linalg.norm(missing, axis=2).max(), rel=1e-3)


def test_a_still_tree_has_no_error(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    still = np.zeros((mesh.num_vertices, 16, 3), np.complex64)
    _, summary = animated(mesh, still, truth=lambda: iter(to_motion(still)))
    assert summary.relative_error == 0


def test_an_animated_glb_keeps_the_look_and_is_read_by_others(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    content, _ = animated(mesh, sway(rng, mesh))
    result = read_mesh(io.BytesIO(content), file_type="glb")
    np.testing.assert_array_equal(result.vertices, mesh.vertices)
    np.testing.assert_array_equal(result.faces, mesh.faces)
    np.testing.assert_array_equal(result.look.uv, mesh.look.uv)
    np.testing.assert_array_equal(result.look.vertex_colors, mesh.look.vertex_colors)
    assert result.look.materials == mesh.look.materials
    scene = trimesh.load_scene(io.BytesIO(content), file_type="glb")
    assert sum(len(part.faces) for part in scene.geometry.values()) == mesh.num_faces


def test_every_frame_of_the_zip_is_the_mesh_at_that_frame(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    coefficients = sway(rng, mesh)
    archive = archive_of(iter_ply_files(mesh, iter_motion(coefficients, np.arange(5) / 100)))
    assert archive.testzip() is None  # checksums
    assert archive.namelist() == [f"frame_{n:04d}.ply" for n in range(5)]
    for name, displacement in zip(archive.namelist(), to_motion(coefficients)[:5], strict=True):
        result = read_mesh(io.BytesIO(archive.read(name)), file_type="ply", reading=Reading(up_axis="+Z", unit_m=1.0))
        np.testing.assert_allclose(result.vertices, mesh.vertices + displacement, atol=1e-5)
        np.testing.assert_array_equal(result.faces, mesh.faces)
        np.testing.assert_array_equal(result.look.vertex_colors, mesh.look.vertex_colors)


def test_frames_are_asked_for_one_at_a_time(rng: np.random.Generator) -> None:
    mesh = trunk_and_crown(rng)
    frames = iter(np.zeros((3, mesh.num_vertices, 3), np.float32))
    next(iter_ply_files(mesh, frames))
    assert len(list(frames)) == 2


def test_an_archive_is_stored_and_does_not_depend_on_the_clock() -> None:
    files = [("a.ply", [b"ply", b"", b"x" * 10]), ("b.ply", [b""])]
    archive = archive_of(files)
    assert archive.read("a.ply") == b"ply" + b"x" * 10
    for entry in archive.infolist():
        assert entry.compress_type == zipfile.ZIP_STORED
        assert entry.flag_bits == 0  # no descriptors, so that whoever streams can follow
        assert entry.date_time == (1980, 1, 1, 0, 0, 0)


def test_a_motion_file_holds_every_frame(rng: np.random.Generator) -> None:
    mesh, stream = trunk_and_crown(rng), io.BytesIO()
    displacement = rng.normal(size=(7, mesh.num_vertices, 3)).astype(np.float32)
    write_motion(mesh, iter(displacement), stream, num_frames=7, fps=24.0)
    result = load(stream.getvalue())
    np.testing.assert_array_equal(result["displacement"], displacement)
    np.testing.assert_array_equal(result["vertices"], mesh.vertices)
    np.testing.assert_array_equal(result["faces"], mesh.faces)
    assert b'"fps":"24.0"' in stream.getvalue()
