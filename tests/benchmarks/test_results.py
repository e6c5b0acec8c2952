"""The figures that the documentation states are those that were recorded."""

from benchmarks import _results


def test_the_page_is_what_the_recorded_results_say() -> None:
    assert _results.PAGE.read_text() == _results.fill_template("page.md"), "make results NAMES=write"


def test_the_readme_is_what_the_recorded_results_say() -> None:
    assert _results.README.read_text() == _results.readme(), "make results NAMES=write"
