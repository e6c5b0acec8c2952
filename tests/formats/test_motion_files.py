"""PLY sequences, motion files and animated GLBs hold the motion that the spectrum tells."""

import io
import zipfile
from typing import Any

import numpy as np
import pygltflib
import pytest
from safetensors.numpy import load

from benchmarks._read_exports import accessor, read_morphs
from dynamictree.formats.gltf.motion import MorphSummary, write_motion_glb
from dynamictree.formats.mesh.ply_writer import iter_ply_files
from dynamictree.formats.tensors.motion import write_motion
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from dynamictree.spectrum import from_motion, iter_motion, to_motion
from tests.formats.meshes import read, trunk_and_crown, written
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
    return accessor(document, sampler.input)[:, 0], read_morphs(content)


@pytest.mark.parametrize("num_frames", [100, 61])
def test_31_targets_are_exact_at_the_keys_and_the_last_equals_the_first(rng, num_frames: int) -> None:
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


def test_a_whole_spectrum_of_an_even_period_is_exact_too(rng) -> None:
    mesh = trunk_and_crown(rng)
    motion = rng.normal(size=(20, mesh.num_vertices, 3)).astype(np.float32)
    content, _ = animated(mesh, from_motion(motion, 11), num_frames=20)
    np.testing.assert_allclose(played(content)[1][:-1], motion, atol=1e-5)
    _, still = animated(
        mesh,
        np.zeros((mesh.num_vertices, 16, 3), np.complex64),
        truth=lambda: iter(np.zeros((100, mesh.num_vertices, 3), np.float32)),
    )
    assert still.relative_error == 0


def test_an_animated_glb_keeps_the_look_at_rest_and_its_weights_fit_a_slider(rng) -> None:
    mesh = trunk_and_crown(rng)
    content, _ = animated(mesh, sway(rng, mesh))
    result = read(content, "glb")
    for name in ("vertices", "faces"):
        np.testing.assert_array_equal(getattr(result, name), getattr(mesh, name))
    np.testing.assert_array_equal(result.look.uv, mesh.look.uv)
    np.testing.assert_array_equal(result.look.vertex_colors, mesh.look.vertex_colors)
    assert result.look.materials == mesh.look.materials
    document = pygltflib.GLTF2().load_from_bytes(content)
    keys = accessor(document, document.animations[0].samplers[0].output)
    assert 0 <= keys.min() <= keys.max() <= 1
    assert not document.meshes[0].weights, "all 0: the mesh at rest"


def test_every_frame_of_the_zip_is_the_mesh_at_that_frame(rng) -> None:
    mesh = trunk_and_crown(rng)
    coefficients = sway(rng, mesh)
    archive = archive_of(iter_ply_files(mesh, iter_motion(coefficients, np.arange(3) / 100)))
    frames = iter(np.zeros((3, mesh.num_vertices, 3), np.float32))
    next(iter_ply_files(mesh, frames))
    assert len(list(frames)) == 2  # asked for one at a time
    assert archive.testzip() is None  # checksums
    assert archive.namelist() == [f"frame_{n:04d}.ply" for n in range(3)]
    for name, displacement in zip(archive.namelist(), to_motion(coefficients)[:3], strict=True):
        result = read(archive.read(name), "ply", reading=Reading(up_axis="+Z", unit_m=1.0))
        np.testing.assert_allclose(result.vertices, mesh.vertices + displacement, atol=1e-5)
        np.testing.assert_array_equal(result.faces, mesh.faces)
        np.testing.assert_array_equal(result.look.vertex_colors, mesh.look.vertex_colors)


def test_an_archive_is_stored_and_does_not_depend_on_the_clock() -> None:
    archive = archive_of([("a.ply", [b"ply", b"", b"x" * 10]), ("b.ply", [b""])])
    assert archive.read("a.ply") == b"ply" + b"x" * 10
    for entry in archive.infolist():
        assert entry.compress_type == zipfile.ZIP_STORED
        assert entry.flag_bits == 0  # no descriptors, so that whoever streams can follow
        assert entry.date_time == (1980, 1, 1, 0, 0, 0)


def test_a_motion_file_holds_every_frame(rng) -> None:
    mesh = trunk_and_crown(rng)
    displacement = rng.normal(size=(7, mesh.num_vertices, 3)).astype(np.float32)
    content = written(write_motion, mesh, iter(displacement), num_frames=7, fps=24.0)
    result = load(content)
    np.testing.assert_array_equal(result["displacement"], displacement)
    np.testing.assert_array_equal(result["vertices"], mesh.vertices)
    np.testing.assert_array_equal(result["faces"], mesh.faces)
    assert b'"fps":"24.0"' in content
