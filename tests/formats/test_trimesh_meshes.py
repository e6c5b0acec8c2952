"""Formats that trimesh reads, and meshes handed over to and taken from trimesh."""

import io
import tracemalloc
from collections.abc import Mapping

import numpy as np
import pytest
import trimesh
from PIL import Image

from dynamictree.errors import FormatError, InputError, MeshError
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading
from tests.formats.meshes import image_bytes, named_collada, trunk_and_crown, zipped

KINDS = ["off", "3mf", "dae"]


def exported(mesh: TriangleMesh, kind: str) -> bytes:
    content = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type=kind)
    return content.encode() if isinstance(content, str) else content


def read(content: bytes, kind: str, companions: Mapping[str, bytes] | None = None, **options: object) -> TriangleMesh:
    assert sniff_file_type(content[:65536], f"tree.{kind}") == kind
    return read_mesh(io.BytesIO(content), file_type=kind, companions=companions, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_the_file_s_vertices_come_in_its_order(rng, kind: str) -> None:
    mesh = trunk_and_crown(rng)
    result = read(exported(mesh, kind), kind, reading=Reading(up_axis="+Z", unit_m=1.0))
    if kind == "dae":  # COLLADA's writer gives each face corners of its own
        np.testing.assert_allclose(result.vertices[result.faces], mesh.vertices[mesh.faces], atol=1e-5)
    else:
        np.testing.assert_allclose(result.vertices, mesh.vertices, atol=1e-5)
        np.testing.assert_array_equal(result.faces, mesh.faces)


def test_a_3mf_is_in_its_own_unit_and_stands_on_z(rng) -> None:
    mesh = trunk_and_crown(rng)
    result = read(exported(mesh, "3mf"), "3mf")
    assert (result.source.up_axis, result.source.scale) == ("+Z", 0.001)
    assert result.height_m == pytest.approx(mesh.height_m / 1000, rel=1e-4)


def test_a_collada_file_s_axis_and_unit_are_its_own(rng) -> None:
    content = exported(trunk_and_crown(rng), "dae")
    declared = b'<asset><unit name="inch" meter="0.0254"/><up_axis>Z_UP</up_axis>'
    start, end = content.index(b"<asset"), content.index(b"</asset>")
    result = read(content[:start] + declared + content[end:], "dae")
    assert (result.source.up_axis, result.source.scale) == ("+Z", 0.0254)


@pytest.mark.parametrize("kind", KINDS)
def test_a_truncated_file_is_refused(rng, kind: str) -> None:
    content = exported(trunk_and_crown(rng), kind)
    for share in (0.3, 0.6, 0.9):
        with pytest.raises(InputError):
            read_mesh(io.BytesIO(content[: int(len(content) * share)]), file_type=kind)


@pytest.mark.parametrize(
    ("content", "kind", "message"),
    [
        (b"OFF\n99999999999 1 0\n0 0 0\n", "off", "99,999,999,999 vertices"),
        (b"OFF\nthree\n", "off", "no counts"),
        (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "off", "outside the range"),
        (b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "b">]><COLLADA/>', "dae", "entities"),
        (b"<COLLADA>", "dae", "cannot be read"),
        (b"PK\x03\x04", "3mf", "archive cannot be read"),
    ],
)
def test_a_hostile_file_is_refused_before_it_is_parsed(content: bytes, kind: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_mesh(io.BytesIO(content), file_type=kind)


def test_a_3mf_that_unpacks_to_much_is_refused_without_unpacking() -> None:
    content = zipped({"3D/3dmodel.model": bytes(200 << 20)})
    tracemalloc.start()
    with pytest.raises(FormatError, match="unpacks to 209,715,200 bytes"):
        read_mesh(io.BytesIO(content), file_type="3mf")
    assert tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()


def test_a_zip_of_something_else_is_no_3mf() -> None:
    with pytest.raises(FormatError, match=r"no 3D/3dmodel\.model"):
        read_mesh(io.BytesIO(zipped({"tree.obj": b"v 0 0 0"})), file_type="3mf")


def test_a_texture_comes_from_trimesh(rng) -> None:
    mesh = trunk_and_crown(rng)
    leaf = trimesh.visual.material.PBRMaterial(
        name="leaf",
        baseColorFactor=[51, 153, 51, 255],
        baseColorTexture=Image.open(io.BytesIO(image_bytes())),
        alphaMode="MASK",
    )
    upward = mesh.look.uv * [1, -1] + [0, 1]
    visual = trimesh.visual.TextureVisuals(uv=upward, material=leaf)
    result = TriangleMesh.from_trimesh(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, visual=visual))
    np.testing.assert_array_equal(result.vertices, mesh.vertices)
    np.testing.assert_array_equal(result.faces, mesh.faces)
    np.testing.assert_allclose(result.look.uv, mesh.look.uv, atol=1e-6)
    assert result.look.materials[0].texture_png is not None
    assert (result.look.materials[0].name, result.look.materials[0].alpha_cutoff) == ("leaf", 0.5)
    np.testing.assert_allclose(result.look.materials[0].base_color, (0.2, 0.6, 0.2, 1.0), atol=1 / 255)


def test_colours_and_placed_parts_come_from_trimesh(rng) -> None:
    mesh = trunk_and_crown(rng)
    own = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, vertex_colors=mesh.look.vertex_colors)
    scene = trimesh.Scene(own)
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = [10, 0, 0]
    scene.add_geometry(own, transform=mirror)
    result = TriangleMesh.from_trimesh(scene)
    np.testing.assert_array_equal(result.vertices[: mesh.num_vertices], mesh.vertices)
    np.testing.assert_allclose(result.vertices[mesh.num_vertices :], mesh.vertices * [-1, 1, 1] + [10, 0, 0], atol=1e-6)
    np.testing.assert_array_equal(result.faces[mesh.num_faces :], mesh.faces[:, ::-1] + mesh.num_vertices)
    np.testing.assert_array_equal(result.look.vertex_colors[: mesh.num_vertices], mesh.look.vertex_colors)


def test_a_scene_of_points_is_no_mesh() -> None:
    with pytest.raises(MeshError, match="no triangles"):
        TriangleMesh.from_trimesh(trimesh.Scene(trimesh.PointCloud(np.zeros((3, 3)))))


def test_names_of_collada_nodes_and_materials_are_those_of_parts() -> None:
    mesh = read_mesh(io.BytesIO(named_collada()), file_type="dae")
    names = [mesh.parts.names[part] for part in mesh.parts.of_face]
    assert names == ["Trunk", "Trunk", "Pots/FlowerPot/Cylinder", "Pots/Saucer/Cylinder"]
