"""Normals for shading: those of the source where it has any, smooth ones otherwise, turned with the surface."""

import numpy as np
import OpenEXR
import pytest
import trimesh

from dynamictree.formats.gltf.normals import iter_normals, rest_normals
from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.motion.vertex_texture import vertex_texture_files
from dynamictree.mesh import TriangleMesh, vertex_normals
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation
from tests.formats.artists import TURNED, Artist, document_of
from tests.formats.looks import angles_rad
from tests.formats.meshes import read, trunk_and_crown, written
from tests.formats.stored import archive_of

ROOF = "v 0 0 0\nv 2 0 0\nv 2 1 1\nv 0 1 1\nv 2 2 0\nv 0 2 0\nvn 0 -1 1\nvn 0 1 1\n"


def ball() -> TriangleMesh:
    source = trimesh.creation.icosphere(subdivisions=4, radius=2.0)
    return TriangleMesh(vertices=np.array(source.vertices, np.float32), faces=np.array(source.faces, np.int32))


def box() -> TriangleMesh:
    source = trimesh.creation.box((1, 2, 3))
    source.unmerge_vertices()
    return TriangleMesh(vertices=np.array(source.vertices, np.float32), faces=np.array(source.faces, np.int32))


@pytest.mark.parametrize("place", [{}, TURNED, {"scale": [-2, 1, 3]}])
def test_normals_of_gltf_stay_across_their_faces_wherever_a_node_puts_them(place: dict[str, object]) -> None:
    artist = Artist()
    corners = np.float32([[0, 0, 0], [1, 0.5, 0], [0, 1, 0.3]])
    across = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normals = np.tile(across / np.linalg.norm(across), (3, 1)).astype(np.float32)
    attributes = {"POSITION": artist.accessor(corners), "NORMAL": artist.accessor(normals)}
    artist.add("meshes", {"primitives": [{"attributes": attributes}]})
    artist.add("nodes", {"mesh": 0, **place})
    artist.scene(0)
    mesh = read(artist.glb(), "glb")
    faces = vertex_normals(mesh.vertices.astype(np.float64), mesh.faces).astype(np.float32)
    assert angles_rad(mesh.look.normals, faces).max() < 1e-5


def test_normals_of_obj_are_turned_upright_with_it() -> None:
    faces = "f 1//1 2//1 3//1 4//1\nf 4//2 3//2 5//2 6//2\n"
    mesh = read((ROOF + faces).encode(), "obj", reading=Reading(up_axis="+Y", unit_m=1.0))
    half = np.sqrt(0.5)
    of_corners = mesh.look.normals[mesh.faces]
    np.testing.assert_allclose(of_corners[:2], np.full((2, 3, 3), [0, -half, -half]), atol=1e-6)  # (0, -1, 1) of +Y up
    np.testing.assert_allclose(of_corners[2:], np.full((2, 3, 3), [0, -half, half]), atol=1e-6)
    assert mesh.num_vertices == 8  # the ridge has both


def test_one_direction_of_several_lines_in_an_obj_is_one_normal() -> None:
    faces = "vn 0 0.7072 0.7071\nf 1//2 2//2 3//2 4//2\nf 4//3 3//3 5//3 6//3\n"
    assert read((ROOF + faces).encode(), "obj", reading=Reading(up_axis="+Y", unit_m=1.0)).num_vertices == 6


@pytest.mark.parametrize("faces", ["f 1//9 2//9 3//9\n", "f 1//a 2//1 3//-7\n", "vn 0 1\nf 1//1 2//1 3//1\n"])
def test_damaged_normals_of_obj_refuse_no_file(faces: str) -> None:
    mesh = read((ROOF + faces).encode(), "obj", reading=Reading(up_axis="+Z", unit_m=1.0))
    assert np.isfinite(rest_normals(mesh)).all()


def test_without_normals_a_ball_is_smooth_and_a_box_has_edges() -> None:
    sphere = ball()
    assert angles_rad(rest_normals(sphere), sphere.vertices).max() < 0.01
    cube = box()
    faces = vertex_normals(cube.vertices.astype(np.float64), cube.faces).astype(np.float32)
    assert angles_rad(rest_normals(cube), faces).max() < 1e-5


def test_a_seam_of_the_texture_does_not_show() -> None:
    sphere = ball()
    split = TriangleMesh(
        vertices=sphere.vertices[sphere.faces.ravel()],
        faces=np.arange(3 * sphere.num_faces, dtype=np.int32).reshape(-1, 3),
    )
    assert angles_rad(rest_normals(split), split.vertices).max() < 0.02


def test_every_written_glb_has_normals_of_unit_length() -> None:
    document = document_of(written(write_glb, ball()))
    (primitive,) = document.root["meshes"][0]["primitives"]
    normals = document.accessor(primitive["attributes"]["NORMAL"])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    positions = document.accessor(primitive["attributes"]["POSITION"])
    assert angles_rad(normals, positions).max() < 0.01


def test_normals_turn_with_the_surface() -> None:
    sphere = ball()
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 0.5])[:3, :3]
    (normals,) = iter_normals(sphere, [(sphere.vertices @ turn.T - sphere.vertices).astype(np.float32)])
    assert angles_rad(normals, (sphere.vertices @ turn.T).astype(np.float32)).max() < 0.01


def test_the_normal_texture_has_the_normals_of_every_frame(rng, tmp_path) -> None:
    mesh = trunk_and_crown(rng)
    motion = rng.normal(0, 0.05, (20, mesh.num_vertices, 3)).astype(np.float32)
    normals = list(iter_normals(mesh, motion))
    files = vertex_texture_files(mesh, list(motion), num_frames=20, fps=24.0, loop=True, normals=normals)
    archive = archive_of(files)
    picture = OpenEXR.File(archive.extract("normal.exr", tmp_path)).channels()["RGB"].pixels.astype(np.float32)
    rows = len(picture) // 20
    for number in (0, 7):
        texels = picture[number * rows : (number + 1) * rows].reshape(-1, 3)[: mesh.num_vertices]
        np.testing.assert_allclose(texels, normals[number] @ up_rotation("+Y").astype(np.float32), atol=1e-3)
