"""`evaluate` from end to end, with a network small enough for a test."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from dynamictree.spectrum import to_motion
from lab.commands.evaluate import print_classifier, print_figures
from lab.evaluation.figures import TreeReference, figures_of
from lab.evaluation.held_out_trees import HeldOutTree, iter_sapling, read_sapling, sapling_files
from lab.evaluation.report import TARGETS, targets_of


def ran(commands: Typer, *arguments: str) -> tuple[dict, str]:
    """The report, and what was said beside it."""
    result = CliRunner().invoke(
        commands, [*arguments, "--threads", "1", "--json"], catch_exceptions=False, env={"DYNAMICTREE_SAMPLES": None}
    )
    return json.loads(result.stdout), result.stderr


def test_the_truth_itself_is_perfect(palm: HeldOutTree) -> None:
    figures = figures_of(palm.truth, TreeReference.of(palm))
    for name in ("log_amplitude_correlation", "centroid_correlation", "roughness_ratio", "smoothness_loss_ratio"):
        assert getattr(figures, name) == pytest.approx(1, abs=1e-6), name
    assert figures.size_ratio == figures.lean_ratio == 1
    assert figures.log_amplitude_rmse == figures.energy_distance == 0
    assert figures.phase_agreement == figures.phase_agreement_truth


def test_noise_between_neighbours_shows_in_smoothness_and_roughness(palm: HeldOutTree) -> None:
    rng = np.random.default_rng(0)
    rough = (palm.truth * np.exp(0.5j * rng.standard_normal((len(palm.truth), 1, 1)))).astype(np.complex64)
    figures = figures_of(rough, TreeReference.of(palm))
    assert figures.smoothness_loss_ratio > 1.05
    assert figures.roughness_ratio > 1.5
    assert figures.phase_agreement < figures.phase_agreement_truth
    assert figures.log_amplitude_rmse == pytest.approx(0, abs=1e-5)


@pytest.mark.slow
def test_evaluation_judges_the_truth_as_good_and_an_untrained_network_as_not(commands: Typer, untrained: Path) -> None:
    report, said = ran(commands, "--model", str(untrained), "--trees", "1", "--training-trees", "2", "--steps", "1")
    assert set(report["groups"]) == {"seen-species", "unseen-species"}
    for rows in report["groups"].values():
        assert rows["representation"]["log_amplitude_correlation"] > 0.99
        assert rows["second wind"]["log_amplitude_rmse"] < rows["by-height mean"]["log_amplitude_rmse"]
        for figure in ("roughness_ratio", "smoothness_loss_ratio"):
            assert abs(rows["second wind"][figure] - 1) < abs(rows["by-height mean"][figure] - 1)
        assert rows["representation"]["log_amplitude_rmse"] < rows["by-height mean"]["log_amplitude_rmse"]
    for energies in report["energy_by_frequency"].values():
        assert all(sum(shares) == pytest.approx(1, abs=1e-3) for shares in energies.values())
    assert [one["figure"] for one in report["targets"]] == [target.figure for target in TARGETS]
    assert report["passes"] is False
    assert report["frame_distances"] == {}
    assert said.count("no frames are judged") == 1
    assert said.count("--samples") == 1


@pytest.mark.slow
def test_the_add_ons_trees_are_a_third_group(commands: Typer, untrained: Path, samples) -> None:
    arguments = ("--model", str(untrained), "--trees", "1", "--training-trees", "1", "--steps", "1")
    report, _ = ran(commands, *arguments, "--samples", str(samples))
    rows = report["groups"]["sapling"]
    assert report["trees"]["sapling"] == 2
    assert rows["representation"]["log_amplitude_correlation"] > 0.97
    assert "second wind" not in rows


def test_the_add_ons_trees_are_judged_by_their_own_frames(samples) -> None:
    files = sapling_files(samples)
    for path, tree in zip(files, iter_sapling(files), strict=True):
        motion = to_motion(tree.truth)
        baked = read_sapling(path).displacement
        assert np.linalg.norm(motion - baked) < 0.05 * np.linalg.norm(baked)


def test_figures_and_verdicts_are_printed_for_people(capsys) -> None:
    figures = {target.figure: 0.5 for target in TARGETS}
    methods = dict.fromkeys(("model", "second wind", "by-height mean"), figures)
    report = {"model": "small", "trees": {"unseen-species": 3}, "groups": {"unseen-species": methods}}
    report |= {"frame_distances": {"unseen-species": {"truth": {"clip_i": 0.01, "clip_t": 0.02}}}}
    print_figures({**report, "targets": targets_of(methods), "rule": "the rule", "passes": False})
    text = capsys.readouterr().out
    assert "unseen-species: mean over 3 trees" in text
    assert "stretch p99 at most 0.05: 0.500 (a second true wind 0.500), missed by 0.450" in text
    assert "loop jump at most 1: 0.500 (a second true wind 0.500), met" in text
    assert "small does not pass: the rule" in text
    print_classifier({"right": {"model": 0.613}, "valid": True, "rule": "a rule", "trees": 20, "mean_voxels": 9000.0})
    assert "true motion and model separated in 61.3 % of cases\nvalid: a rule; 20 trees" in capsys.readouterr().out
