import pytest

from tests.style.words import violations

CLEAN = b'''"""Where the pull is fixed; `held` is the API's word, and photos may be held out."""

held_out = 3  # reported


class NotFoundError(Exception):
    process: int


def test_files_are_found_where_they_were_made() -> None:
    """The tree made of what was found."""
'''


def test_plain_words_and_terms_pass() -> None:
    assert list(violations("dynamictree/pull.py", CLEAN)) == []


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("a.py", "told = 1"),
        ("a.py", "x.held = 1"),
        ("a.py", "def the_known_trees(): ..."),
        ("a.py", "class KeptTree: ..."),
        ("a.py", "def draw(shown): ..."),
        ("a.py", "import numpy as here"),
        ("a.py", "def process(): ..."),
        ("a.py", "data = 1"),
        ("a.py", "def test_what_is_wrong_is_told(): ..."),
        ("a.py", "x = 1  # as it is told"),
        ("tests/a.py", "x = 0.1  # of the height"),
        ("a.py", '"""What is kept."""'),
        ("a.py", 'x = 1\n"""Held at its root."""'),
        ("dynamictree/utils.py", "x = 1"),
        ("web/page/jobs.js", "const kept = 1;"),
        ("docs/viewer.md", "Paths are kept."),
    ],
)
def test_a_planted_word_is_reported_with_its_line(path: str, line: str) -> None:
    planted = f"\n{line}\n".encode()
    (message,) = violations(path, planted)
    assert message.startswith(f"{path}:")
    assert "`" in message


def test_only_the_listed_places_may_use_a_vague_name() -> None:
    assert list(violations("service/schemas/jobs.py", b"data: int\n")) == []
    assert list(violations("service/app.py", b"data: int\n"))
