"""GLB with EXT_meshopt_compression: what we write and read, judged by glTF-Transform with meshoptimizer."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pygltflib
import pytest

from benchmarks._read_exports import accessor, read_skin, z_up
from dynamictree.errors import FormatError, InputError
from dynamictree.export.write import write_products
from dynamictree.formats.gltf.document import open_gltf
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import ExportParams
from dynamictree.spectrum import SparseVoxelSpectrum
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.formats.artists import document_of
from tests.formats.meshes import gltf_bytes
from tests.js_tools import by_node

LARGEST_M = 1e-3
"""Of a compressed GLB's vertices to those of the plain one, in any frame."""
Tree = tuple[TriangleMesh, SparseVoxelSpectrum]
Files = dict[str, tuple[bytes, dict[str, float]]]


@pytest.fixture(scope="module")
def tree() -> Tree:
    sample = make_sample(3, "sapling")
    return sample.mesh, replace(voxel_spectrum(sample, 32)[1], fps=7.68, num_frames=32)


@pytest.fixture(scope="module")
def files(tree: Tree, tmp_path_factory) -> Files:
    """GLBs with and without compression, and their stated errors."""
    written: Files = {}
    for compression in ("none", "meshopt"):
        facts: dict[str, dict[str, float]] = {}
        params = ExportParams(formats=("glb",), glb_compression=compression, flutter=0.0, joints=64)
        paths = write_products(*tree, params, tmp_path_factory.mktemp(compression), on_facts=facts.__setitem__)
        written[compression] = paths["glb"].read_bytes(), facts["glb"]
    return written


def frames(content: bytes) -> np.ndarray:
    """Vertices of the first primitive at every key."""
    document = pygltflib.GLTF2().load_from_bytes(content)
    return z_up(accessor(document, document.meshes[0].primitives[0].attributes.POSITION)) + read_skin(content)


def test_a_compressed_file_shows_the_motion_and_says_how_far_off_it_is(files: Files) -> None:
    (plain, before), (packed, facts) = files["none"], files["meshopt"]
    assert len(packed) < 0.6 * len(plain)
    gap = np.linalg.norm(frames(packed) - frames(plain), axis=2)[:-1]
    assert 0 < gap.max() < LARGEST_M
    assert facts["max_error_m"] == pytest.approx(gap.max() + before["max_error_m"], rel=1e-2)
    assert facts["rms_error_m"] == pytest.approx(np.hypot(np.sqrt((gap**2).mean()), before["rms_error_m"]), rel=1e-2)


def test_a_compressed_file_is_read_as_the_mesh_that_it_holds(files: Files, tree: Tree) -> None:
    mesh = read_mesh(io.BytesIO(files["meshopt"][0]), file_type="glb")
    np.testing.assert_array_equal(np.sort(mesh.faces, axis=1), np.sort(tree[0].faces, axis=1))
    np.testing.assert_allclose(mesh.vertices, tree[0].vertices, atol=1e-4)
    assert b"meshopt" not in mesh.gltf.document


def changed(content: bytes, change: dict[str, object], *, cut: int = 0) -> bytes:
    """The file with another description of its first compressed view, or with bytes of it lost."""
    document = document_of(content)
    view = next(one for one in document.root["bufferViews"] if "extensions" in one)
    entry = view["extensions"]["EXT_meshopt_compression"]
    entry.update(change)
    binary = bytearray(document.buffers[0])
    binary[entry["byteOffset"] : entry["byteOffset"] + cut] = b"\xff" * cut
    return gltf_bytes(document.root, bytes(binary))


@pytest.mark.parametrize(
    ("change", "cut", "message"),
    [
        ({}, 8, "cannot be decoded"),
        ({"byteLength": 1 << 39}, 0, "truncated"),
        ({"count": 1 << 31, "byteStride": 256}, 0, "more than 1,073,741,824 bytes"),
        ({"mode": "OTHER"}, 0, "mode must be"),
        ({"buffer": 9}, 0, "0 to 1"),
    ],
)
def test_a_damaged_stream_is_refused(files: Files, change: dict[str, object], cut: int, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        open_gltf(changed(files["meshopt"][0], change, cut=cut), companions={})


def test_without_the_binding_files_are_refused_with_the_command(
    files: Files, tree: Tree, monkeypatch, tmp_path
) -> None:
    monkeypatch.setitem(sys.modules, "meshopt", None)
    with pytest.raises(FormatError, match=r"pip install 'dynamictree\[meshopt\]'"):
        open_gltf(files["meshopt"][0], companions={})
    with pytest.raises(InputError, match=r"pip install 'dynamictree\[meshopt\]'"):
        write_products(*tree, ExportParams(formats=("glb",), glb_compression="meshopt"), tmp_path)


def by_gltf_transform(*arguments: str | Path) -> str:
    return by_node("meshopt_gltf.mjs", *arguments, package="@gltf-transform")


@pytest.mark.slow
def test_gltf_transform_reads_what_we_write(files: Files, tmp_path) -> None:
    (tmp_path / "packed.glb").write_bytes(files["meshopt"][0])
    read = np.array(json.loads(by_gltf_transform("read", tmp_path / "packed.glb"))).reshape(-1, 3)
    document = pygltflib.GLTF2().load_from_bytes(files["none"][0])
    truth = accessor(document, document.meshes[0].primitives[0].attributes.POSITION)
    assert np.linalg.norm(read - truth, axis=1).max() < LARGEST_M


@pytest.mark.slow
def test_we_read_what_gltf_transform_packs(files: Files, tree: Tree, tmp_path) -> None:
    (tmp_path / "plain.glb").write_bytes(files["none"][0])
    by_gltf_transform("pack", tmp_path / "plain.glb", tmp_path / "packed.glb")
    packed = (tmp_path / "packed.glb").read_bytes()
    assert b"EXT_meshopt_compression" in packed
    mesh = read_mesh(io.BytesIO(packed), file_type="glb")
    assert mesh.num_faces == tree[0].num_faces
    np.testing.assert_allclose(mesh.vertices.max(axis=0), tree[0].vertices.max(axis=0), atol=2e-3)
