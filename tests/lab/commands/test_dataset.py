import json

import pytest
from typer.testing import CliRunner

from dynamictree.errors import InputError
from lab.commands.dataset import app

run = CliRunner().invoke


def ran(*arguments):
    result = run(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_generate_writes_what_it_tells(tmp_path):
    report = json.loads(ran("generate", tmp_path, "--trees", 1, "--resolution", 32, "--first-seed", 50, "--json"))
    assert report["trees"] == 1
    assert report["complete"]
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert (tmp_path / manifest["shards"][0]["file"]).stat().st_size == report["bytes"]


def test_generate_honours_the_review(tmp_path):
    review = tmp_path / "review.txt"
    review.write_text("0 reject\n")
    ran("generate", tmp_path / "set", "--trees", 1, "--resolution", 32, "--review", review)
    record = json.loads((tmp_path / "set" / "4dtree-00000.json").read_text())
    assert [tree["seed"] for tree in record["trees"]] == [1]
    assert record["rejected"] == {"0": {"rules": ["curation"]}}
    assert record["verdicts"]["curation"] == 1


@pytest.mark.parametrize("shard", ["1", "a/2", "1/b"])
def test_a_shard_that_is_none_is_refused(tmp_path, shard):
    with pytest.raises(InputError, match="--shard"):
        ran("generate", tmp_path, "--shard", shard)


def test_filter_prints_the_rate_of_each_rule():
    text = ran("filter", "--trees", 2, "--species", "sapling", "--self-explosion", 0)
    assert "rejected self-explosion: 2 of 2 (100.00 %)" in text
    assert "rejected root-motion: 0 of 2 (0.00 %)" in text
    report = json.loads(ran("filter", "--trees", 1, "--species", "sapling", "--json"))
    assert report["seen"] == 1
    assert 0 < report["worst"]["self_explosion"] < 1


def test_sheet_draws_pages_and_never_overwrites_a_review(tmp_path):
    arguments = ("sheet", "-o", tmp_path, "--trees", 2, "--rows", 1, "--species", "sapling", "--json")
    assert len(json.loads(ran(*arguments))["pages"]) == 2
    assert (tmp_path / "review.txt").read_text().splitlines()[1:] == ["0 accept sapling", "1 accept sapling"]
    (tmp_path / "review.txt").write_text("0 reject\n")
    ran(*arguments)
    assert (tmp_path / "review.txt").read_text() == "0 reject\n"
