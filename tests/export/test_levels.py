"""Levels of detail have fewer triangles and the motion of the tree, as tools that are not ours read them."""

import io
import json
import zipfile

import numpy as np
import pygltflib
import pytest
import trimesh
from PIL import Image

from benchmarks._read_exports import accessor, read_morphs, z_up
from dynamictree import method
from dynamictree.export.levels import SHARES, motion_error
from dynamictree.export.moving_tree import Facts
from dynamictree.mesh import TriangleMesh, connected_parts
from dynamictree.spectrum import to_motion
from tests.export.conftest import NUM_FRAMES, Products, Sapling

Written = tuple[TriangleMesh, np.ndarray, zipfile.ZipFile, Facts]


@pytest.fixture(scope="module")
def written(sapling: Sapling, products: Products) -> Written:
    mesh, spectrum = sapling
    truth = to_motion(method.devoxelize(spectrum, mesh), NUM_FRAMES)
    return mesh, truth, zipfile.ZipFile(products[0]["lod"]), products[1]["lod"]


def positions(content: bytes) -> np.ndarray:
    document = pygltflib.GLTF2().load_from_bytes(content)
    return z_up(accessor(document, document.meshes[0].primitives[0].attributes.POSITION))


def test_levels_have_their_share_of_triangles_and_report_it(written: Written) -> None:
    mesh, _, archive, facts = written
    stated = json.loads(archive.read("lod.json"))["levels"]
    assert [entry["num_triangles"] for entry in stated] == [facts[f"lod{n}_triangles"] for n in range(5)]
    for number, share in enumerate(SHARES):
        scene = trimesh.load(io.BytesIO(archive.read(f"tree-lod{number}.glb")), file_type="glb")
        count = sum(len(part.faces) for part in scene.geometry.values())
        assert count == stated[number]["num_triangles"]
        assert count == pytest.approx(share * mesh.num_faces, rel=0.25)
    errors = [entry["relative_error"] for entry in stated]
    assert errors[0] == 0 < errors[1] < errors[2] < errors[3] < 0.35
    assert [entry["coverage"] for entry in stated] == sorted((entry["coverage"] for entry in stated), reverse=True)


def test_wood_moves_as_the_tree_does_and_the_error_is_the_reported_one(written: Written) -> None:
    mesh, truth, archive, facts = written
    content = archive.read("tree-lod1.glb")
    rest, played = positions(content), read_morphs(content)[:NUM_FRAMES]
    places = {place.tobytes(): number for number, place in enumerate(mesh.vertices)}
    same = [(n, places[p.tobytes()]) for n, p in enumerate(rest.astype(np.float32)) if p.tobytes() in places]
    assert len(same) > 0.3 * len(rest)
    own, source = np.array(same).T
    assert np.abs(played[:, own] - truth[:, source]).max() < 1e-6
    surface = trimesh.util.concatenate(list(trimesh.load(io.BytesIO(content), file_type="glb").geometry.values()))
    surface = trimesh.Trimesh(z_up(np.asarray(surface.vertices)), surface.faces, process=False)
    some = np.arange(0, mesh.num_vertices, 5)
    nearest, _, face = trimesh.proximity.closest_point_naive(surface, mesh.vertices[some])
    weights = trimesh.triangles.points_to_barycentric(surface.triangles[face], nearest)
    order = np.argmin(((surface.vertices[:, None] - rest[None]) ** 2).sum(axis=2), axis=1)  # our row of each vertex
    moved = np.einsum("pc,tpcx->tpx", weights, played[:, order[surface.faces[face]]])
    gap, whole = ((moved - truth[:, some]) ** 2).sum(), (truth[:, some] ** 2).sum()
    assert np.sqrt(gap / whole) == pytest.approx(facts["lod1_relative_error"], rel=0.3)


def test_leaves_that_stay_hang_where_they_hung(written: Written) -> None:
    mesh, _, archive, _ = written
    leaf = mesh.faces[mesh.look.face_material == 1]
    part = connected_parts(leaf, mesh.num_vertices)
    for number in (1, 2, 3):
        content = archive.read(f"tree-lod{number}.glb")
        document = pygltflib.GLTF2().load_from_bytes(content)
        rest = positions(content).astype(np.float32)
        corners = accessor(document, document.meshes[0].primitives[1].indices).reshape(-1, 3).astype(np.int32)
        own = connected_parts(corners, len(rest))
        remaining = np.unique(own[corners])
        stays = {place.tobytes(): number for number, place in enumerate(mesh.vertices)}
        for leaf_part in remaining:
            places = rest[np.unique(corners[own[corners[:, 0]] == leaf_part])]
            at = [stays[place.tobytes()] for place in places if place.tobytes() in stays]
            assert len(at) >= 1
            assert len(np.unique(part[at])) == 1


def test_cards_show_the_tree_and_sway_with_it(written: Written) -> None:
    mesh, truth, archive, _ = written
    content = archive.read("tree-lod4.glb")
    document = pygltflib.GLTF2().load_from_bytes(content)
    view = document.bufferViews[document.images[0].bufferView]
    png = document.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    alpha = np.asarray(Image.open(io.BytesIO(png)))[:, :, 3] > 127
    assert 0.02 < alpha.mean() < 0.6
    assert alpha[-8:].any()  # the stem reaches the ground
    rest, played = positions(content), read_morphs(content)[:NUM_FRAMES]
    top, of_tree = rest[:, 2] > 0.8 * rest[:, 2].max(), mesh.vertices[:, 2] > 0.8 * mesh.height_m
    mean = truth[:, of_tree].mean(axis=1)
    cards = played[:, top].mean(axis=1)
    assert np.sqrt(((cards - mean) ** 2).sum() / (mean**2).sum()) < 0.35
    assert np.abs(played[:, rest[:, 2] == rest[:, 2].min()]).max() < 0.05 * np.abs(played).max()


def test_vertices_of_no_face_do_not_count_as_an_error() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, 1]], np.float32)
    mesh = TriangleMesh(vertices=vertices, faces=np.array([[0, 1, 2]], np.int32))
    motion = np.ones((4, 2, 3), np.complex64)
    motion[3] = 0
    level = TriangleMesh(vertices=vertices[:3], faces=mesh.faces)
    assert motion_error(mesh, motion, level, motion[:3], 8)[0] == pytest.approx(0, abs=1e-6)
