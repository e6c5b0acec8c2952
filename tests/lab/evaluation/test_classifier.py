"""The classifier tells what differs, guesses what does not, and is only believed where it tells an easy fake."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from dynamictree.errors import InputError
from lab.evaluation.classifier import classify, cross_validate, features_of
from lab.evaluation.figures import TreeReference
from lab.evaluation.held_out_trees import HeldOutTree


def test_what_differs_is_separated_and_what_does_not_is_guessed(rng) -> None:
    one, other = rng.standard_normal((120, 4)), rng.standard_normal((120, 4))
    assert cross_validate(one, other, seed=0) == pytest.approx(0.5, abs=0.12)
    other[:, 3] += 4
    assert cross_validate(one, other, seed=0) > 0.95


def test_a_tree_is_never_on_both_sides_of_a_split(rng) -> None:
    """Were it, of two equal rows the one learnt would mislead about the other: right in no case."""
    tree = rng.standard_normal((100, 4))
    assert cross_validate(tree, tree.copy(), seed=0) == 0.5


def test_features_do_not_change_with_the_compass_or_the_unit(palm: HeldOutTree) -> None:
    plain = features_of(palm.truth, TreeReference.of(palm))
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    mesh = palm.mesh.with_vertices(np.ascontiguousarray(palm.mesh.vertices @ quarter.T))
    wind = replace(palm.wind, direction_deg=palm.wind.direction_deg + 90)
    truth = np.ascontiguousarray(palm.truth @ quarter.T).astype(np.complex64)
    turned = features_of(truth, replace(TreeReference.of(palm), tree=replace(palm, mesh=mesh, wind=wind)))
    assert set(turned) == set(plain)
    for name, value in plain.items():
        assert turned[name] == pytest.approx(value, rel=1e-3, abs=1e-5), name


@pytest.mark.slow
@pytest.mark.timeout(900)  # looks at many trees for twenty small ones
def test_an_untrained_network_is_separated_and_another_true_wind_is_not(untrained: Path) -> None:
    report = classify(str(untrained), num_trees=20, max_voxels=9000, seed=0)
    assert report["right"]["model"] > 0.9
    assert report["right"]["second wind"] < 0.8
    assert report["valid"]
    assert report["mean_voxels"] <= 9000


def test_a_limit_that_no_tree_meets_is_reported(untrained: Path) -> None:
    with pytest.raises(InputError, match="at most 10 voxels"):
        classify(str(untrained), num_trees=1, max_voxels=10, seed=0, num_training=1, tries=1)


def test_two_kinds_of_run_at_once_are_refused(commands: Typer, untrained: Path) -> None:
    arguments = ["--model", str(untrained), "--laws", "--classifier", "--json"]
    result = CliRunner().invoke(commands, arguments)
    assert isinstance(result.exception, InputError)
    assert "give one of them" in str(result.exception)
