"""Laws of real trees on the simulator."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from dynamictree.formats.gltf.writer import write_glb
from lab.commands.evaluate import print_laws
from lab.dataset.oscillator import damping_ratio, stem_bin
from lab.dataset.sample import make_sample
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from lab.evaluation.laws import FREQUENCY_BANDS_HZ, evaluate_laws, frequency_band, law_shares, measure_tree


@pytest.mark.parametrize(("bare", "slack"), [(False, 1.0), (True, 1.1)])
def test_the_simulators_frequency_lies_in_the_band_at_every_measured_height(bare: bool, slack: float) -> None:
    """The band falls by a third where a class of heights begins: there bare trees are up to 9 % above it."""
    for height_m in np.linspace(4.0, 50.0, 93):
        low, high = frequency_band(float(height_m)) or (np.nan, np.nan)
        frequency_hz = float(stem_bin(np.array([height_m], np.float32), bare=bare)[0]) * 24 / 100
        assert low <= frequency_hz <= slack * high, height_m


def test_a_tree_is_slower_and_more_damped_in_leaf_than_bare() -> None:
    length = np.array([0.2, 3.0, 12.0, 25.0], np.float32)
    slower = stem_bin(length) / stem_bin(length, bare=True)
    assert ((slower > 0.79) & (slower < 0.94)).all()  # measured, docs/laws.md
    assert damping_ratio(bare=True) == 0.039
    assert 0.1 < damping_ratio(bare=False) < 0.17


def test_trunks_of_the_dataset_keep_their_frequency() -> None:
    for name, species in SPECIES.items():
        assert species.height_m[1] <= 15.0, name
    length = np.array([0.3, 1.0, 15.0, 16.9], np.float32)
    np.testing.assert_allclose(stem_bin(length), 24 / (8 * np.pi) / np.sqrt(length) * 100 / 24, rtol=1e-6)
    assert make_sample(3, "spire-conifer").coefficients.any()


def test_trees_of_eight_metres_satisfy_the_laws_in_leaf_and_bare() -> None:
    leaf, bare = measure_tree("maple", 8.0, 1), measure_tree("bare-winter", 8.0, 1)
    assert np.isnan(law_shares([leaf])["bare trees less damped"])
    assert set(law_shares([leaf, bare]).values()) == {1.0}
    as_damped = replace(bare, damping_ratio=leaf.damping_ratio)
    assert law_shares([leaf, as_damped])["bare trees less damped"] == 0.0


def test_a_tree_that_breaks_a_law_is_counted() -> None:
    tree = measure_tree("maple", 8.0, 1)
    broken = [
        replace(tree, frequency_hz=2.0),
        replace(tree, released_hz=0.01),
        replace(tree, damping_ratio=0.3),
        replace(tree, spectral_slope=0.1),
        replace(tree, orbit=0.0),
        replace(tree, response=2.5, response_in_storm=2.6),
    ]
    names = list(law_shares([tree]))
    for case, law in zip(broken, [names[0], names[1], names[2], names[4], names[5], names[6]], strict=True):
        assert law_shares([case, tree])[law] == 0.5, law


def test_heights_without_measurements_have_no_band() -> None:
    assert frequency_band(3.0) is None
    assert frequency_band(70.0) is None
    assert frequency_band(4.0) == FREQUENCY_BANDS_HZ[4, 8]


def test_the_command_reports_shares_and_trees(commands: Typer, capsys: pytest.CaptureFixture[str]) -> None:
    result = CliRunner().invoke(commands, ["--laws", "--trees", "2", "--json"], catch_exceptions=False)
    report = json.loads(result.stdout)
    assert len(report["trees"]) == 2
    assert report == json.loads(json.dumps(evaluate_laws(2)))
    print_laws(report)
    assert "orbit" in capsys.readouterr().out
    both = CliRunner().invoke(commands, ["--laws", "--classifier"])
    assert both.exit_code != 0


def test_the_motion_that_a_model_generates_of_a_tree_satisfies_the_laws(commands: Typer, tmp_path: Path) -> None:
    tree = grow_tree(replace(SPECIES["columnar"], height_m=(6.0, 6.0)), np.random.default_rng(2))
    with (tmp_path / "columnar.glb").open("wb") as stream:
        write_glb(tree.mesh, stream)
    result = CliRunner().invoke(
        commands, ["--laws", "--tree", str(tmp_path), "--height-m", "7", "--json"], catch_exceptions=False
    )
    report = json.loads(result.stdout)
    assert report["tree"]["height_m"] == pytest.approx(7, rel=0.02)
    assert set(report["laws"].values()) == {True}


def test_motions_that_a_model_generates_of_grown_trees_satisfy_the_laws(commands: Typer) -> None:
    arguments = ["--laws", "--generated", "--trees", "2", "--seed", "5", "--json"]
    report = json.loads(CliRunner().invoke(commands, arguments, catch_exceptions=False).stdout)
    assert [tree["species"] for tree in report["trees"]] == list(SPECIES)[:2]
    of_sway = {law: share for law, share in report["laws"].items() if "band for the height" not in law}
    assert all(share == 1 or math.isnan(share) for share in of_sway.values())
    simulated = evaluate_laws(2, seed=5)["trees"]
    assert all(one["response"] != other["response"] for one, other in zip(report["trees"], simulated, strict=True))


def test_a_tree_is_measured_for_the_laws_only(commands: Typer, tmp_path: Path) -> None:
    path = tmp_path / "tree.glb"
    path.touch()
    result = CliRunner().invoke(commands, ["--tree", str(path)])
    assert "--tree and --generated are for --laws" in str(result.exception)
    without = CliRunner().invoke(commands, ["--laws", "--height-m", "7"])
    assert "give that too" in str(without.exception)
