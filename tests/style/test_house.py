"""Laws of the counts: each sees what it is to see, and the code keeps its bounds."""

from pathlib import Path

from tests.style.house import BOUNDS, counts, numbers_in, violations, wide_functions_in

ROOT = Path(__file__).resolve().parents[2]


def test_numbers_at_module_level_count_and_others_do_not() -> None:
    """Two of a tuple, one in a table, one annotated; not a text, a flag, a local number or a bare annotation."""
    source = "A, B = 1, 2\nC = {'x': 0.5}\nD: int = 3\nE = 'text'\nF = True\nG: int\ndef f():\n    h = 4\n"
    assert numbers_in(source) == 4


def test_a_wide_function_has_seven_arguments() -> None:
    """`self` does not count, keywords do, and a kernel is none."""
    narrow = (
        "def f(a, b, c, *, d, e, f): ...\n"
        "class C:\n    def g(self, a, b, c, d, e, f): ...\n"
        "@compiled\ndef k(a, b, c, d, e, f, g): ...\n"
    )
    assert wide_functions_in(narrow) == 0
    assert wide_functions_in(narrow + "def h(a, b, c, d, *, e, f, g): ...\n") == 1


def test_the_house_keeps_its_bounds_and_tells_what_breaks_them(tmp_path: Path) -> None:
    """A count above its bound is told with both; every count has a bound."""
    assert counts(tmp_path).keys() == BOUNDS.keys()
    assert not list(violations(ROOT))
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "long.py").write_text("\n" * (BOUNDS["lines in lab"] + 1))
    (message,) = violations(tmp_path)
    assert f"{BOUNDS['lines in lab'] + 1:,} lines in lab" in message
