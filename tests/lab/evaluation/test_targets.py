import pytest

from lab.evaluation.report import TARGETS, passes, targets_of

GOOD = {
    "log_amplitude_correlation": 0.95,
    "log_amplitude_rmse": 0.2,
    "centroid_correlation": 0.9,
    "roughness_ratio": 0.9,
    "stretch_p99": 0.03,
    "root_share": 0.001,
    "loop_jump": 0.7,
}


def methods(model, baseline):
    return {"model": model, **dict.fromkeys(("by-height mean", "second wind"), baseline)}


def test_a_good_model_meets_every_target():
    worse = {**GOOD, "log_amplitude_rmse": 0.4, "roughness_ratio": 1.3, "stretch_p99": 0.03}
    report = targets_of(methods(GOOD, worse))
    assert [one["figure"] for one in report] == [target.figure for target in TARGETS]
    assert all(one["met"] and one["missed_by"] == 0 for one in report)


@pytest.mark.parametrize("figure", [target.figure for target in TARGETS])
def test_a_miss_is_reported_with_its_size(figure):
    poor = {**GOOD, figure: GOOD[figure] - 0.6 if figure.endswith("correlation") else GOOD[figure] + 5}
    (report,) = [one for one in targets_of(methods(poor, GOOD)) if not one["met"]]
    assert report["figure"] == figure
    assert report["missed_by"] > 0.3
    assert report["floor"] == GOOD[figure]


def test_weights_ship_only_if_better_than_by_height_and_not_too_rough():
    worse = {**GOOD, "log_amplitude_rmse": 0.4}
    assert passes(methods(GOOD, worse))
    assert not passes(methods(GOOD, GOOD))
    assert not passes(methods({**GOOD, "roughness_ratio": 1.6}, worse))
