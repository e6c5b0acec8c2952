"""A mesh that one process hands to another arrives as it was."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import load, save

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.tensors.mesh_bundle import VERSION, read_mesh_bundle, write_mesh_bundle
from dynamictree.mesh import Material, MeshLook, TriangleMesh
from dynamictree.source import Source

LOOK = MeshLook(
    uv=np.array([[0, 0], [1, 0], [0, 1]], np.float32),
    vertex_colors=np.array([[1, 2, 3, 4]] * 3, np.uint8),
    face_material=np.array([1], np.int32),
    materials=(Material(name="bark"), Material(name="leaf", texture_png=b"\x89PNG", alpha_cutoff=0.5)),
)
LEAF = TriangleMesh(
    vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 2]], np.float32),
    faces=np.array([[0, 1, 2]], np.int32),
    look=LOOK,
    source=Source(up_axis="+Y", scale=0.01),
)


def written(mesh: TriangleMesh) -> bytes:
    stream = io.BytesIO()
    write_mesh_bundle(mesh, stream)
    return stream.getvalue()


@pytest.mark.parametrize("absent", [(), ("uv", "vertex_colors", "face_material")])
def test_read_undoes_write(absent: tuple[str, ...]) -> None:
    mesh = replace(LEAF, look=replace(LOOK, **dict.fromkeys(absent)))
    back = read_mesh_bundle(io.BytesIO(written(mesh)))
    for name in ("vertices", "faces"):
        np.testing.assert_array_equal(getattr(back, name), getattr(mesh, name))
    for name in ("uv", "vertex_colors", "face_material"):
        np.testing.assert_array_equal(getattr(back.look, name), getattr(mesh.look, name))
    assert (back.look.materials, back.source) == (mesh.look.materials, mesh.source)


def test_another_version_is_refused() -> None:
    tensors = load(written(LEAF))
    rest = json.loads(tensors["rest"].tobytes()) | {"version": VERSION + 1}
    tensors["rest"] = np.frombuffer(json.dumps(rest).encode(), np.uint8)
    with pytest.raises(FormatError, match="version"):
        read_mesh_bundle(io.BytesIO(save(tensors)))


@pytest.mark.parametrize("content", [b"", b"nonsense", save({"vertices": np.zeros((3, 3), np.float32)})])
def test_what_is_no_bundle_is_refused(content: bytes) -> None:
    with pytest.raises(FormatError, match="mesh bundle"):
        read_mesh_bundle(io.BytesIO(content))


def test_a_mesh_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(MeshError):
        read_mesh_bundle(io.BytesIO(written(replace(LEAF, vertices=np.full((3, 3), np.nan, np.float32)))))


@pytest.mark.parametrize(
    "rest",
    [
        b"\x89 is no UTF-8",
        b"[]",
        b'{"version": 1}',
        json.dumps({"version": VERSION, "materials": [7], "source_up_axis": "+Z", "source_scale": 1}).encode(),
        json.dumps({"version": VERSION, "materials": [{"colour": 1}], "source_up_axis": "+Z"}).encode(),
    ],
)
def test_a_bundle_whose_fields_were_changed_is_refused(rest: bytes) -> None:
    tensors = load(written(LEAF)) | {"rest": np.frombuffer(rest, np.uint8)}
    with pytest.raises(FormatError, match="mesh bundle"):
        read_mesh_bundle(io.BytesIO(save(tensors)))
