"""Crossed trees: parts of species that are for training, never of those held out."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import pdist

from lab.dataset.generate import Recipe, generate
from lab.dataset.mixed_species import MAX_LEAVES, MAX_STEMS, MIXED_SPECIES, mix_species
from lab.dataset.sample import make_sample
from lab.dataset.sapling import LEAF
from lab.dataset.species import SPECIES


def test_parts_are_of_species_for_training_and_bounded() -> None:
    rng = np.random.default_rng(0)
    crossed = [one for one in (mix_species(rng) for _ in range(300)) if one.foliage.kind != "clump"]
    trunks = {replace(species.levels[0], taper=0.0) for species in SPECIES.values() if not species.held_out}
    assert {replace(one.levels[0], taper=0.0) for one in crossed} <= trunks
    assert {one.foliage.kind for one in crossed} == {"none", "leaf", "cluster", "needle"}
    assert {len(one.levels) for one in crossed} == {2, 3, 4}
    for one in crossed:
        stems = np.prod([level.count for level in one.levels[1:]])
        assert stems <= MAX_STEMS + 1e-6
        assert one.foliage.kind == "none" or stems * one.foliage.count <= MAX_LEAVES + 1e-6


def test_clumps_are_closed_and_each_is_rigid() -> None:
    sample = make_sample(5007, MIXED_SPECIES)  # its foliage follows the stems' own nodes
    assert len(sample.motion.position) == len(sample.skeleton.position)
    faces = sample.mesh.faces
    crown = np.flatnonzero(sample.part == LEAF)
    assert len(crown)
    assert trimesh.Trimesh(sample.mesh.vertices, faces[np.isin(faces[:, 0], crown)], process=False).is_watertight
    moved = sample.mesh.vertices + sample.displacement()[37]
    for node in np.unique(sample.node[crown]):
        own = crown[sample.node[crown] == node]
        before, after = (pdist(where[own]) for where in (sample.mesh.vertices, moved))
        np.testing.assert_allclose(after, before, rtol=1e-3, atol=1e-4)


def test_a_seed_is_a_tree_and_says_that_it_is_crossed() -> None:
    first, again, other = (make_sample(seed, MIXED_SPECIES) for seed in (3, 3, 5))
    assert first.species == MIXED_SPECIES
    assert first.split == "train"
    np.testing.assert_array_equal(first.coefficients, again.coefficients)
    assert first.mesh.num_vertices != other.mesh.num_vertices
    assert make_sample(3).species in SPECIES


@pytest.mark.parametrize("species", [None, MIXED_SPECIES])
def test_the_recipe_of_a_shard_tells_the_species_where_it_is_asked_for(species, tmp_path) -> None:
    manifest = generate(Recipe(trees=1, resolutions=(32,), species=species), tmp_path)
    record = json.loads((tmp_path / "4dtree-00000.json").read_text())
    assert record["recipe"].get("species") == species
    assert (manifest["species"] == {MIXED_SPECIES: 1}) == (species == MIXED_SPECIES)
    card = (tmp_path / "README.md").read_text()
    assert ("--species crossed" in card) == (species == MIXED_SPECIES)
    assert "origin + (coords + ½) · size" in card
