"""Each tree of a file moves as it would alone, on its own foot; one can be chosen by its number."""

import io
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dynamictree import method
from dynamictree.errors import FormatError
from dynamictree.export.write import write_products
from dynamictree.formats.tensors.bundle import read_cloud_bundle, read_mesh_bundle, write_bundle
from dynamictree.formats.tensors.spectrum import read_spectrum, write_spectrum
from dynamictree.formats.tensors.voxels import read_voxels, write_voxels
from dynamictree.mesh import StillPart, TriangleMesh, edges_of, join_meshes
from dynamictree.modal.bones import bones_of
from dynamictree.modal.force import Drag, contact_at_voxel
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.joints import joints_of
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import default_falloff_m, modal_system
from dynamictree.models.several_trees import tree_voxels
from dynamictree.plant.capture import Capture, carrying_mesh, moving_part, only_tree, with_one_moving_tree
from dynamictree.plant.trees.of_mesh import stand_resolution
from dynamictree.requests import CloudParams, ExportParams
from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.voxelize import SurfaceVoxels
from tests.formats.meshes import written
from tests.plant.stand import tree
from tests.service.test_clouds import post_cloud


@pytest.fixture(scope="module")
def pair() -> TriangleMesh:
    """Two trees whose crowns touch, labelled."""
    left, right = tree(6.0, seed=0, num_cards=60), tree(5.0, seed=1, num_cards=60)
    both = join_meshes([left, right.with_vertices(right.vertices + np.float32([2.1, 0, 0]))])
    return replace(both, face_tree=np.repeat(np.int32([0, 1]), [left.num_faces, right.num_faces]))


@pytest.fixture(scope="module")
def swaying(pair: TriangleMesh) -> tuple[SurfaceVoxels, SparseVoxelSpectrum]:
    voxels = method.voxelize(pair)
    return voxels, method.generate(voxels, wind=Wind(), seed=3, num_steps=1)


def test_a_tree_moves_as_it_does_alone_and_its_foot_stays(pair, swaying) -> None:
    voxels, spectrum = swaying
    for number in (0, 1):
        rows = np.flatnonzero(voxels.tree == number)
        alone = method.generate(tree_voxels(voxels, rows), wind=Wind(), seed=3 + number, num_steps=1)
        assert (spectrum.coefficients[rows] == alone.coefficients).all()
    motion = np.abs(method.devoxelize(spectrum, pair)).max(axis=(1, 2))
    for number, height_m in ((0, 6.0), (1, 5.0)):
        own = np.unique(pair.faces[pair.face_tree == number])
        up = pair.vertices[own, 2] / height_m
        assert motion[own][up < 0.02].max() < 1e-3 * height_m
        assert motion[own][up > 0.6].mean() > 20 * motion[own][up < 0.02].max()


def test_a_pull_on_a_tree_leaves_the_others_still(pair, swaying) -> None:
    voxels, spectrum = swaying
    spectrum = read_spectrum(io.BytesIO(written(write_spectrum, spectrum)))
    system = modal_system(spectrum)
    one, other = (np.flatnonzero(voxels.tree == number) for number in (0, 1))
    pulled = int(one[np.argmin(cKDTree(voxels.grid.centres_m[other]).query(voxels.grid.centres_m[one])[0])])
    drag = Drag(at=contact_at_voxel(system.grid, pulled), displacement_m=(1.0, 0.0, 0.0))
    stand = InteractiveTree(system, rig_of(pair, spectrum), pair)
    groups = group_forces([drag], falloff_m=default_falloff_m(system))
    answer = respond(system, groups, dt_s=1 / 30, num_frames=1, start="held", tree=stand)
    moved = np.linalg.norm(next(iter(stand.voxels(answer))), axis=1)
    assert moved[pulled] > 0.8
    assert moved[voxels.tree == 1].max() < 1e-6


def test_each_tree_has_joints_of_its_own(pair, swaying) -> None:
    voxels, spectrum = swaying
    joints = joints_of(bones_of(rig_of(pair, spectrum)), pair, spectrum.coefficients[:, 1:])
    trees_of: dict[int, set[int]] = {}
    for voxel, number in enumerate(voxels.tree.tolist()):
        for joint in joints.chain(voxel).tolist():
            trees_of.setdefault(joint, set()).add(number)
    assert set(map(frozenset, trees_of.values())) == {frozenset({0}), frozenset({1})}


def test_the_products_of_a_stand_keep_lengths_in_each_tree(pair: TriangleMesh, tmp_path) -> None:
    spectrum = method.generate(method.voxelize(pair), wind=Wind(speed_m_s=20.0), num_steps=1)
    edges = edges_of(pair.faces)
    rest = np.linalg.norm(pair.vertices[edges[:, 0]] - pair.vertices[edges[:, 1]], axis=1)
    growth = []
    for moved in method.move(spectrum, pair, num_frames=10):
        now = pair.vertices + moved
        growth.append(
            np.abs(np.linalg.norm(now[edges[:, 0]] - now[edges[:, 1]], axis=1)[rest > 0] / rest[rest > 0] - 1)
        )
    assert np.percentile(growth, 99) < 0.01
    paths = write_products(pair, spectrum, ExportParams(formats=("motion",)), tmp_path)
    assert paths["motion"].stat().st_size > 12 * 100 * pair.num_vertices


def test_trees_side_by_side_get_a_grid_as_fine_as_a_single_one(pair: TriangleMesh) -> None:
    alone = tree(6.0)
    apart = join_meshes([alone, alone.with_vertices(alone.vertices + np.float32([24, 0, 0]))])
    labelled = replace(apart, face_tree=np.repeat(np.int32([0, 1]), alone.num_faces))
    assert [stand_resolution(mesh, 128) for mesh in (alone, pair, labelled)] == [128, 128, 512]


def test_bundles_and_voxel_files_hold_the_trees(pair: TriangleMesh) -> None:
    assert (read_mesh_bundle(io.BytesIO(written(write_bundle, pair))).face_tree == pair.face_tree).all()
    voxels = method.voxelize(pair, resolution=32)
    assert (read_voxels(io.BytesIO(written(write_voxels, voxels))).tree == voxels.tree).all()
    content = written(write_voxels, replace(voxels, tree=np.full(len(voxels.grid), -1, np.int32)))
    with pytest.raises(FormatError, match="trees are numbered from -1"):
        read_voxels(io.BytesIO(content))


def test_one_tree_of_a_cloud_is_cut_out_or_moves_alone_and_the_ground_stays() -> None:
    post = post_cloud(400)
    means = np.concatenate([post.means, post.means + np.float32([3, 0, 0])])
    cloud = replace(post.subset(np.arange(400).repeat(2).reshape(400, 2).T.ravel()), means=means)
    number = np.repeat(np.int32([0, 1]), 400)
    number[:10] = -1
    capture = Capture(cloud=cloud, tree=number)
    assert (read_cloud_bundle(io.BytesIO(written(write_bundle, capture))).tree == number).all()
    assert moving_part(capture).sum() == 790
    assert (only_tree(capture, 2).cloud.means[:, 0] > 1.5).all()
    grounded = replace(
        capture, still_parts=(StillPart(name="ground", why="flat"),), part_of=np.zeros(len(number), np.uint8)
    )
    second, low = only_tree(grounded, 2), ((-9.0, -9.0, -9.0), (9.0, 9.0, 0.5))
    moving = moving_part(second, CloudParams(still=("ground",), still_box_m=low))
    np.testing.assert_array_equal(moving, second.cloud.means[:, 2] > 0.5)
    assert (moving_part(with_one_moving_tree(capture, 2)) == (number == 1)).all()
    mesh = carrying_mesh(capture)
    assert ((mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 1.5) == (mesh.face_tree == 1)).all()
