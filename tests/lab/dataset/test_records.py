"""Figures read from a baked folder equal those generated again from its seeds."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from typer.testing import CliRunner

from dynamictree.errors import FormatError, InputError
from lab.commands.dataset import app
from lab.dataset.filter import measure
from lab.dataset.generate import Recipe, generate, shard_name
from lab.dataset.limits import DatasetLimits
from lab.dataset.records import iter_seen
from lab.dataset.sample import make_sample
from lab.dataset.stats import MEASURED, numbers_of, table_facts, table_of, tables_of

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
    seen = list(iter_seen(folder))
    assert [tree.seed for tree in seen] == [40, 42]
    for tree in seen:
        again = make_sample(tree.seed)
        assert asdict(tree.measures) == asdict(measure(again))
        assert tree.species == again.species == tree.stems.species


def test_a_tree_that_a_rule_rejected_is_seen_too(tmp_path):
    measures = measure(make_sample(40))
    recipe = Recipe(
        trees=1, first_seed=40, resolutions=(32,), limits=DatasetLimits(self_explosion=0.99 * measures.self_explosion)
    )
    generate(recipe, tmp_path)
    accepted, rejected, *_ = iter_seen(tmp_path)
    assert (rejected.seed, rejected.broken, rejected.measures) == (40, ("self-explosion",), measures)
    assert rejected.stems is None
    assert accepted.measures.self_explosion <= recipe.limits.self_explosion
    assert accepted.stems is not None


def test_a_table_keeps_counts_and_medians_on_its_way_through_json(sapling):
    table = tables_of(sapling)
    back = table_of("sapling", json.loads(json.dumps(table_facts(table))))
    assert back.count.sum() == len(table.level)
    assert (back.height_m, back.wind_speed_m_s) == (pytest.approx(table.height_m, abs=1e-4), table.wind_speed_m_s)
    for name in MEASURED:
        medians = [np.median(getattr(table, name)[table.level == depth]) for depth in back.level]
        np.testing.assert_allclose(getattr(back, name), medians, atol=1e-6)
    whole, short = (numbers_of([one])["levels"] for one in (table, back))
    assert [level["stems_a_tree"] for level in whole.values()] == [level["stems_a_tree"] for level in short.values()]


def test_filter_and_stats_read_a_folder(folder, tmp_path):
    report = ran("filter", folder, "--self-explosion", 0, "--json")
    assert (report["seen"], report["accepted"], report["self-explosion"]) == (2, 0, 2)
    species = make_sample(40).species
    assert ran("filter", folder, "--species", species, "--json")["seen"] >= 1
    report = ran("stats", folder, "-o", tmp_path, "--json")
    assert report["trees"] == 2
    assert (tmp_path / "stats.png").read_bytes().startswith(b"\x89PNG")


def test_a_sheet_of_a_folder_shows_the_accepted_trees(folder, tmp_path):
    ran("sheet", folder, "-o", tmp_path, "--trees", 1, "--first-seed", 41, "--json")
    assert (tmp_path / "review.txt").read_text().splitlines()[1].startswith("42 accept")


@pytest.mark.parametrize("command", ["filter", "stats"])
def test_a_species_that_the_folder_lacks_is_reported(folder, tmp_path, command):
    arguments = [command, folder, "--species", "oak", *(["-o", tmp_path] if command == "stats" else [])]
    with pytest.raises(InputError, match="of species 'oak'"):
        ran(*arguments)


def test_a_folder_without_shards_or_of_an_earlier_program_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="no shard lies in"):
        list(iter_seen(tmp_path))
    record = json.loads((folder / f"{shard_name(0)}.json").read_bytes())
    for tree in record["trees"]:
        del tree["measures"]
    (tmp_path / f"{shard_name(0)}.json").write_text(json.dumps(record))
    with pytest.raises(FormatError, match="has no measures"):
        list(iter_seen(tmp_path))
