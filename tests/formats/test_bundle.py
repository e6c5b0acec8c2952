"""A mesh that one process hands to another arrives as it was."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import load, save

from dynamictree.errors import FormatError, MeshError
from dynamictree.formats.tensors.bundle import VERSION, read_mesh_bundle, write_bundle
from dynamictree.mesh import Material, MeshLook, TriangleMesh
from dynamictree.source import Source
from tests.formats.meshes import written

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


@pytest.mark.parametrize("absent", [(), ("uv", "vertex_colors", "face_material")])
def test_read_undoes_write(absent: tuple[str, ...]) -> None:
    mesh = replace(LEAF, look=replace(LOOK, **dict.fromkeys(absent)))
    back = read_mesh_bundle(io.BytesIO(written(write_bundle, mesh)))
    for name in ("vertices", "faces"):
        np.testing.assert_array_equal(getattr(back, name), getattr(mesh, name))
    for name in ("uv", "vertex_colors", "face_material"):
        np.testing.assert_array_equal(getattr(back.look, name), getattr(mesh.look, name))
    assert (back.look.materials, back.source) == (mesh.look.materials, mesh.source)


@pytest.mark.parametrize("content", [b"", b"nonsense", save({"vertices": np.zeros((3, 3), np.float32)})])
def test_what_is_no_bundle_is_refused(content: bytes) -> None:
    with pytest.raises(FormatError, match="no bundle"):
        read_mesh_bundle(io.BytesIO(content))


@pytest.mark.parametrize(
    "change", [{"vertices": np.full((3, 3), np.nan, np.float32)}, {"faces": np.array([[0, 1, 3]], np.int32)}]
)
def test_a_mesh_that_cannot_be_used_is_refused(change: dict[str, np.ndarray]) -> None:
    with pytest.raises(MeshError):
        read_mesh_bundle(io.BytesIO(written(write_bundle, replace(LEAF, **change))))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ("\udc89 is no UTF-8", "no bundle"),
        ([], "no bundle"),
        ({"version": VERSION + 1}, "version"),
        ({"version": VERSION}, "no bundle"),
        ({"version": VERSION, "TriangleMesh": {"vertices": {"tensor": "99"}}}, "no bundle"),
        ({"version": VERSION, "TriangleMesh": {"vertices": [[0, 0, 0]], "faces": {"tensor": "1"}}}, "no bundle"),
        ({"version": VERSION, "TriangleMesh": {"vertices": {"tensor": "1"}, "faces": {"tensor": "0"}}}, "no bundle"),
    ],
)
def test_a_bundle_whose_fields_were_changed_is_refused(fields: object, message: str) -> None:
    text = json.dumps(fields, ensure_ascii=False).encode(errors="surrogateescape")
    content = save(load(written(write_bundle, LEAF)) | {"fields": np.frombuffer(text, np.uint8)})
    with pytest.raises(FormatError, match=message):
        read_mesh_bundle(io.BytesIO(content))
