"""A slice of `make fuzz`: five broken files of every format are read or refused, and nothing else happens."""

import os

import pytest

from tests.fuzz.__main__ import case
from tests.fuzz.forks import attempt
from tests.fuzz.readers import READERS
from tests.fuzz.seeds import seeds

GOOD = seeds()


@pytest.mark.parametrize("kind", GOOD)
def test_a_good_file_is_read_and_a_broken_one_refused(kind: str) -> None:
    for sample in GOOD[kind]:
        READERS[kind](sample)  # imports lazy modules here, so that no fork has to import them again
    outcomes = [attempt(READERS[kind], case(kind, index, 1, GOOD)) for index in range(5)]
    assert [outcome.detail for outcome in outcomes if outcome.faulty] == []


@pytest.mark.parametrize(
    ("read", "verdict"),
    [
        (lambda _: [0] * (1 << 30), "MemoryError"),
        (lambda _: os.abort(), "crash"),
        (lambda _: 1 / 0, "ZeroDivisionError"),
        (lambda _: os._exit(3), "crash"),
    ],
)
def test_what_a_file_must_not_do_is_reported(read: object, verdict: str) -> None:
    assert attempt(read, b"").verdict == verdict
