"""Mesh files: read undoes write, vertex order included."""

import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.mesh import MeshLook, TriangleMesh, unit_vectors
from dynamictree.requests import Reading
from tests.formats.meshes import read, trunk_and_crown, written

WRITERS = {"glb": write_glb, "ply": write_ply, "obj": write_obj}

shapes = given(
    seed=st.integers(0, 2**32),
    sizes=st.tuples(st.integers(3, 40), st.integers(1, 60)),
    has=st.tuples(*[st.booleans()] * 2),
)


def random_mesh(seed: int, sizes: tuple[int, int], has: tuple[bool, bool]) -> TriangleMesh:
    rng = np.random.default_rng(seed)
    num_vertices, num_faces = sizes
    return TriangleMesh(
        vertices=(rng.normal(0, (0.05, 0.05, 1), (num_vertices, 3)) * 10.0 ** rng.integers(-2, 2)).astype(np.float32),
        faces=rng.integers(0, num_vertices, (num_faces, 3)).astype(np.int32),
        look=MeshLook(
            uv=rng.uniform(0, 1, (num_vertices, 2)).astype(np.float32) if has[0] else None,
            vertex_colors=rng.integers(0, 256, (num_vertices, 4)).astype(np.uint8) if has[1] else None,
        ),
    )


@pytest.mark.parametrize(("kind", "uv_error"), [("glb", 0.0), ("ply", 1e-6), ("obj", 1e-6)])
@settings(max_examples=5)
@shapes
def test_corners_coordinates_and_colours(
    kind: str, uv_error: float, seed: int, sizes: tuple[int, int], has: tuple[bool, bool]
) -> None:
    mesh, stream = random_mesh(seed, sizes, has), io.BytesIO()
    WRITERS[kind](mesh, stream)
    reading = None if kind == "glb" else Reading(up_axis="+Z", unit_m=1.0)
    result = read(stream.getvalue(), kind, reading=reading)
    assert_geometry(result, mesh)
    used = np.unique(mesh.faces)  # OBJ has no texture places of vertices without faces, and no alpha
    assert_optional(of_rows(result.look.uv, used), of_rows(mesh.look.uv, used), atol=uv_error)
    channels = slice(0, 3 if kind == "obj" else 4)
    colors = (None if one is None else one[:, channels] for one in (result.look.vertex_colors, mesh.look.vertex_colors))
    assert_optional(*colors, atol=0)


def test_obj_keeps_groups_normals_and_colours(rng) -> None:
    mesh = trunk_and_crown(rng)
    normals = unit_vectors(rng.normal(size=(mesh.num_vertices, 3)))
    colors = rng.integers(0, 256, (mesh.num_vertices, 4)).astype(np.uint8) | np.uint8([0, 0, 0, 255])
    part = rng.integers(0, 2, mesh.num_faces).astype(np.int32)
    names = ("Oak/Lower half", "Crown")
    mesh = replace(
        mesh,
        look=replace(mesh.look, normals=normals, vertex_colors=colors),
        parts=replace(mesh.parts, names=names, of_face=part),
    )
    result = read(written(write_obj, mesh), "obj", reading=Reading(up_axis="+Z", unit_m=1.0))
    assert_geometry(result, mesh)
    assert [result.parts.names[one] for one in result.parts.of_face] == [names[one] for one in part]
    used = np.unique(mesh.faces)
    np.testing.assert_allclose(result.look.normals[used], normals[used], atol=1e-6)
    assert_optional(result.look.vertex_colors, colors, atol=0)


def of_rows(values: np.ndarray | None, rows: np.ndarray) -> np.ndarray | None:
    return None if values is None else values[rows]


def assert_geometry(result: TriangleMesh, expected: TriangleMesh) -> None:
    np.testing.assert_array_equal(result.vertices, expected.vertices)
    np.testing.assert_array_equal(result.faces, expected.faces)


def assert_optional(result: np.ndarray | None, expected: np.ndarray | None, *, atol: float) -> None:
    if expected is None:
        assert result is None
    else:
        np.testing.assert_allclose(result, expected, atol=atol)


def test_glb_and_obj_keep_materials_and_textures_and_an_obj_without_its_library_their_names(rng) -> None:
    mesh, stream = trunk_and_crown(rng), io.BytesIO()
    companions = write_obj(mesh, stream, library="tree.mtl")
    upright = Reading(up_axis="+Z")
    of_obj = read(stream.getvalue(), "obj", reading=upright, companions=companions)
    for result in (read(written(write_glb, mesh), "glb"), of_obj):
        assert result.look.materials == mesh.look.materials
        assert_optional(result.look.face_material, mesh.look.face_material, atol=0)
        assert_geometry(result, mesh)
    alone = read(stream.getvalue(), "obj", reading=upright)
    assert [material.name for material in alone.look.materials] == ["bark", "leaf"]
