"""Figures read from a baked folder equal those generated again from its seeds."""

import json
from dataclasses import asdict

import pytest
from typer.testing import CliRunner

from dynamictree.errors import InputError
from lab.commands.dataset import app
from lab.dataset.filter import iter_measured, measure
from lab.dataset.generate import Recipe, generate
from lab.dataset.limits import DatasetLimits
from lab.dataset.sample import make_sample

REJECTED = 41


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Seeds 40 to 43: 40 and 42 accepted, 41 rejected by a person, none by a rule."""
    folder = tmp_path_factory.mktemp("records")
    generate(Recipe(trees=2, first_seed=40, resolutions=(32,), review={REJECTED: "reject"}), folder)
    return folder


def ran(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def test_records_tell_what_measuring_the_tree_again_tells(folder):
    seen = list(iter_measured(folder))
    assert [tree.seed for tree in seen] == [40, 42]
    for tree in seen:
        again = make_sample(tree.seed)
        assert asdict(tree.measures) == asdict(measure(again))
        assert tree.species == again.species


def test_a_tree_that_a_rule_rejected_is_seen_too(tmp_path):
    measures = measure(make_sample(40))
    recipe = Recipe(
        trees=1, first_seed=40, resolutions=(32,), limits=DatasetLimits(self_explosion=0.99 * measures.self_explosion)
    )
    generate(recipe, tmp_path)
    accepted, rejected, *_ = iter_measured(tmp_path)
    assert (rejected.seed, rejected.violated, rejected.measures) == (40, ("self-explosion",), measures)
    assert accepted.measures.self_explosion <= recipe.limits.self_explosion


def test_filter_reads_a_folder(folder):
    report = ran("filter", folder, "--self-explosion", 0, "--json")
    assert (report["seen"], report["accepted"], report["self-explosion"]) == (2, 0, 2)
    assert ran("filter", folder, "--species", make_sample(40).species, "--json")["seen"] >= 1


def test_a_sheet_of_a_folder_shows_the_accepted_trees(folder, tmp_path):
    ran("sheet", folder, "-o", tmp_path, "--trees", 1, "--first-seed", 41, "--json")
    assert (tmp_path / "review.txt").read_text().splitlines()[1].startswith("42 accept")


def test_a_folder_without_the_species_or_without_shards_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="of species 'oak'"):
        ran("filter", folder, "--species", "oak")
    with pytest.raises(InputError, match="no shard lies in"):
        list(iter_measured(tmp_path))
