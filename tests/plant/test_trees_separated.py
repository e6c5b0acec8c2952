"""Several trees in one file are separated, and one tree stays one."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.formats.description import describe_trees
from dynamictree.mesh import TriangleMesh, join_meshes
from dynamictree.plant.trees.of_mesh import dense_points, mesh_points, only_tree_of, with_trees
from dynamictree.plant.trees.segment import segment_trees
from lab.dataset.species import SPECIES
from tests.devoxelize.test_interpolation import tube
from tests.plant.kinds import verdict
from tests.plant.stand import HEIGHTS_M, PLACES_M, grown, on_ground, scattered, share_right, stand_of_five, tree


def num_trees(mesh: TriangleMesh) -> int:
    return int(segment_trees(dense_points(mesh)[0]).max()) + 1


@pytest.fixture(scope="module")
def five() -> tuple[TriangleMesh, np.ndarray]:
    """Five trees with labels, and the tree of each face in truth."""
    mesh, truth = stand_of_five()
    return with_trees(mesh), truth


def test_five_trees_in_a_mesh_are_separated_and_numbered_from_left_to_right(
    five: tuple[TriangleMesh, np.ndarray],
) -> None:
    labelled, truth = five
    assert labelled.face_tree.max() + 1 == 5
    assert share_right(labelled.face_tree.astype(np.int64), truth) >= 0.95
    assert [warning.code for warning in labelled.warnings] == ["several-trees"]
    order = sorted(range(5), key=lambda number: PLACES_M[number])
    for number, result in zip(order, describe_trees(*mesh_points(labelled)), strict=True):
        np.testing.assert_allclose([result["x_m"], result["y_m"]], PLACES_M[number], atol=0.3)
        assert result["height_m"] == pytest.approx(HEIGHTS_M[number], rel=0.05)


def test_five_trees_in_a_scan_are_separated_by_point_and_the_ground_is_of_none() -> None:
    mesh, truth = stand_of_five()
    face = np.random.default_rng(0).integers(0, mesh.num_faces, 60_000)
    plants, ground = on_ground(scattered(mesh, face).astype(np.float64))
    result = segment_trees(np.concatenate([plants, ground]), is_scan=True)
    assert result.max() == 4
    assert share_right(result[: len(plants)].astype(np.int64), truth[face]) >= 0.95
    assert (result[len(plants) :] == -1).mean() >= 0.9


def test_conifers_whose_boughs_begin_low_and_meet_are_separated() -> None:
    """Stems of 10 m that are bare below 0.9 m only, with boughs of up to 1.8 m, 3 m apart."""
    rng = np.random.default_rng(0)
    height, turn = rng.uniform(0.9, 9.8, (500, 1)), rng.uniform(0, 2 * np.pi, (500, 1))
    away = 0.2 * (10 - height) * np.linspace(0, 1, 70)
    boughs = np.stack([away * np.cos(turn), away * np.sin(turn), height + 0 * away], axis=2).reshape(-1, 3)
    stem = np.c_[rng.normal(scale=0.1, size=(6000, 2)), np.linspace(0, 10, 6000)]
    firs = np.concatenate([np.concatenate([boughs, stem]) + np.array([x, 0, 0]) for x in (0.0, 3.0)])
    labels = segment_trees(firs, is_scan=True)
    assert labels.max() == 1
    assert share_right(labels.astype(np.int64), np.repeat([0, 1], len(firs) // 2)) >= 0.95


def test_one_of_several_trees_is_cut_out_as_it_stands(five: tuple[TriangleMesh, np.ndarray]) -> None:
    labelled, truth = five
    leftmost = only_tree_of(labelled, 1)
    assert leftmost.face_tree is None
    assert leftmost.num_faces == pytest.approx((truth == 4).sum(), rel=0.05)
    np.testing.assert_allclose(leftmost.vertices[:8, :2].mean(axis=0), PLACES_M[4], atol=0.1)
    with pytest.raises(InputError, match="tree is 6, and the file holds 5 trees, numbered from 1"):
        only_tree_of(labelled, 6)
    with pytest.raises(InputError, match="tree is 2, and the file holds 1 tree"):
        only_tree_of(tree(5.0), 2)


@pytest.mark.parametrize("name", SPECIES)
def test_one_tree_of_any_species_stays_one(name: str) -> None:
    mesh = grown(name)
    assert num_trees(replace(mesh, look=replace(mesh.look, materials=(), face_material=None))) == 1


def test_stems_that_grow_from_one_foot_are_of_one_tree() -> None:
    """A birch of three stems that lean apart, and a bush of five."""
    for count, apart, lean in ((3, 0.2, 0.12), (5, 0.35, 0.25)):
        stems = []
        for turn in 2 * np.pi * np.arange(count) / count:
            one = tree(6.0, seed=count, num_cards=120)
            out = np.array([np.cos(turn), np.sin(turn)])
            moved = one.vertices.astype(np.float64)
            moved[:, :2] += out * (apart + lean * moved[:, 2:])
            stems.append(one.with_vertices(moved.astype(np.float32)))
        assert num_trees(join_meshes(stems)) == 1


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_leaves_that_hang_far_out_stand_on_no_ground_of_their_own(turn: float) -> None:
    """A palm: the ends of its fronds hang as thick as its trunk, above nothing."""
    trunk = tube([0, 0, 0], [0, 0, 4.6], 0.15)
    fronds = []
    for one in turn + 2 * np.pi * np.arange(7) / 7:
        out = np.array([np.cos(one), np.sin(one), 0])
        fronds += [
            tube([0, 0, 4.6], 2.8 * out + [0, 0, 4.9], 0.05),
            tube(2.8 * out + [0, 0, 4.9], 2.9 * out + [0, 0, 3.6], 0.15),
        ]
    assert num_trees(join_meshes([trunk, *fronds])) == 1


def test_a_canopy_without_stems_is_refused_with_a_reason() -> None:
    rng = np.random.default_rng(0)
    canopy = np.c_[rng.uniform(0, 60, (40_000, 2)), rng.uniform(6, 8, 40_000)]
    with pytest.raises(InputError, match="no stems are seen by which to separate them"):
        segment_trees(canopy, is_scan=True)
    assert not segment_trees(canopy).any()


def test_files_of_one_tree_stay_one(samples) -> None:
    names = "mesh/tree-lime.glb", "mesh/quaternius_common_tree/CommonTree_2.obj", "scan/tls_tree_1.txt"
    assert [verdict(samples / name)["trees"] for name in (*names, "splat/tree_10k.splat")] == [1, 1, 1, 1]


def test_points_that_are_all_ground_are_one_tree(rng) -> None:
    points = np.column_stack([rng.random((500, 2)) * 10, rng.random(500) * 1e-3])
    assert not segment_trees(points).any()
