"""The figures that the documentation states are those that were recorded."""

import pytest

from benchmarks import _results


def test_the_page_is_what_the_recorded_results_say() -> None:
    assert _results.PAGE.read_text() == _results.fill_template("page.md"), "make results NAMES=write"


def test_the_readme_is_what_the_recorded_results_say() -> None:
    assert _results.README.read_text() == _results.readme(), "make results NAMES=write"


def test_a_result_that_needs_samples_is_left_as_it_was(monkeypatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("DYNAMICTREE_SAMPLES", raising=False)
    monkeypatch.setitem(_results.COMMANDS, "motion", "-c 'raise SystemExit(1)'")
    _results.record("motion")
    assert "set DYNAMICTREE_SAMPLES" in capsys.readouterr().out
