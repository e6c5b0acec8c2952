from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynamictree.mesh import validate_mesh
from lab.dataset.branching import CHILD_TO_PARENT_RADIUS, MIN_RADIUS_M, grow_children, grow_trunks, shape_ratio
from lab.dataset.sapling import LEAF, Tree, grow_tree
from lab.dataset.species import KEY_SPREAD, SPECIES

EVERY_SPECIES = pytest.mark.parametrize("name", list(SPECIES))


@cache
def grown(name: str) -> Tree:
    return grow_tree(SPECIES[name], np.random.default_rng(3))


@pytest.mark.parametrize(
    ("shape", "base", "middle", "top"),
    [
        ("conical", 1.0, 0.525, 0.05),
        ("spherical", 0.2, 1.0, 0.2),
        ("hemispherical", 1.0, 0.2 + 0.8 * np.sqrt(0.5), 0.2),
        ("cylindrical", 1.0, 1.0, 1.0),
        ("tapered-cylindrical", 1.0, 0.75, 0.5),
        ("flame", 0.05, 0.05 + 0.95 * 5 / 7, 0.05),
        ("inverse-conical", 0.2, 0.6, 1.0),
        ("tend-flame", 0.5, 0.5 + 0.5 * 5 / 7, 0.5),
        ("shallow-cone", 0.5, 0.75, 1.0),
    ],
)
def test_shape_functions_take_webers_and_penns_values(shape, base, middle, top):
    ratio = shape_ratio(shape, np.array([1.0, 0.5, 0.0], np.float32))
    np.testing.assert_allclose(ratio, [base, middle, top], rtol=1e-6)


def test_perturbation_moves_key_parameters_far_and_the_rest_a_little(rng):
    species = SPECIES["birch"]
    drawn = [species.perturbed(rng) for _ in range(200)]
    counts = np.array([tree.levels[1].count for tree in drawn]) / species.levels[1].count
    lengths = np.array([tree.levels[1].length for tree in drawn]) / species.levels[1].length
    heights = np.array([tree.height_m[0] for tree in drawn])
    assert np.abs(counts - 1).max() <= KEY_SPREAD
    assert counts.std() > 2 * lengths.std() > 0
    assert species.height_m[0] <= heights.min() < heights.max() <= species.height_m[1]


@EVERY_SPECIES
def test_a_tree_stands_on_the_ground_at_its_height(name):
    tree = grown(name)
    vertices = validate_mesh(tree.mesh).vertices
    low, high = SPECIES[name].height_m
    assert vertices[:, 2].min() == 0
    assert (tree.part[vertices[:, 2] == 0] == 0).all()
    assert 0.6 * low < tree.mesh.height_m < 1.5 * high
    assert 1_000 < tree.mesh.num_vertices < 40_000


@EVERY_SPECIES
def test_the_trunks_foot_is_a_level_ring_around_its_axis(name):
    tree = grown(name)
    sides = tree.stems[0].sides
    foot = tree.mesh.vertices[:sides]
    np.testing.assert_allclose(foot[:, 2], 0, atol=1e-6)
    np.testing.assert_allclose(foot.mean(axis=0), tree.stems[0].points[0, 0], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(foot - foot.mean(axis=0), axis=1), tree.stems[0].radii[0, 0], rtol=1e-4)


@EVERY_SPECIES
def test_every_tube_begins_inside_its_parent(name):
    tree = grown(name)
    for above, stems in zip(tree.stems, tree.stems[1:], strict=False):
        own = stems.first == 0
        ring = stems.parent_ring[own]
        on, row = ring.astype(int), stems.parent[own]
        along = (ring - on)[:, None]
        axis = (1 - along) * above.points[row, on] + along * above.points[row, on + 1]
        np.testing.assert_allclose(stems.points[own, 0], axis, atol=1e-5)
        thickness = (1 - along[:, 0]) * above.radii[row, on] + along[:, 0] * above.radii[row, on + 1]
        inside = stems.radii[own, 0] <= np.maximum(CHILD_TO_PARENT_RADIUS * thickness, MIN_RADIUS_M) * 1.001
        assert inside.all()
        assert (on >= above.first[row]).all()  # on the parent's own part, not on what it shares


def test_a_split_stem_goes_on_from_the_ring_that_it_left():
    forks = 0
    for stems in grown("spreading-broadleaf").stems:
        for row in np.flatnonzero(stems.first):
            ring, source = stems.first[row], stems.parent[row]
            np.testing.assert_array_equal(stems.points[row, ring], stems.points[source, ring])
            assert np.linalg.norm(stems.points[row, ring + 1] - stems.points[source, ring + 1]) > 1e-3
            forks += 1
    assert forks > 3


def test_tubes_are_closed_but_for_the_end_inside_the_parent():
    species = replace(SPECIES["bare-winter"], levels=SPECIES["bare-winter"].levels[:2])
    tree = grow_tree(species, np.random.default_rng(1))
    edges = np.sort(np.concatenate([tree.mesh.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    open_edges = sum(len(stems.points) * stems.sides for stems in tree.stems)
    assert counts.max() == 2
    assert (counts == 1).sum() == open_edges


def test_tubes_thin_towards_the_tip_and_flare_at_the_ground():
    stems = grow_trunks(SPECIES["round-broadleaf"], np.random.default_rng(0))
    assert (np.diff(stems.radii, axis=1) < 0).all()
    first, second, third = stems.radii[0, :3]
    assert first - second > 2 * (second - third)


def test_tropism_lifts_or_hangs_branches():
    species = SPECIES["weeping"]
    trunk = grow_trunks(species, np.random.default_rng(0))
    tips = {}
    for tropism in (-2.0, 0.0, 2.0):
        level = replace(species.levels[1], tropism=tropism, curve_var=0.0)
        own = replace(species, levels=(species.levels[0], level))
        stems = grow_children(own, 1, trunk, np.random.default_rng(1))
        tips[tropism] = (stems.points[:, -1, 2] - stems.points[:, 0, 2]).mean()
    assert tips[-2.0] < tips[0.0] < tips[2.0]


def test_leaves_sit_on_stems_and_off_the_ground():
    for name in ("round-broadleaf", "conical-conifer", "palm", "sapling"):
        tree = grown(name)
        for leaves in tree.leaves:
            stems = tree.stems[leaves.level]
            on = leaves.ring.astype(int)
            along = (leaves.ring - on)[:, None]
            axis = (1 - along) * stems.points[leaves.row, on] + along * stems.points[leaves.row, on + 1]
            np.testing.assert_allclose(leaves.base, axis, atol=1e-4)
        assert tree.mesh.vertices[tree.part == LEAF, 2].min() > 0


def test_the_same_chance_grows_the_same_tree():
    first, second, other = (grow_tree(SPECIES["maple"], np.random.default_rng(seed)).mesh for seed in (1, 1, 2))
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()
    assert first.num_vertices != other.num_vertices
