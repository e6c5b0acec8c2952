"""A small file costs little, whatever it names: each bomb in a fork, its peak measured."""

import pytest

from tests.fuzz.bombs import BOMBS, MOST_MIB
from tests.fuzz.forks import attempt

QUICK = ("one image of many materials", "spz of zeros")  # the others take longer; `make fuzz` throws them all


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in BOMBS]
)
def test_a_bomb_is_refused_before_it_is_unpacked(name: str) -> None:
    make, read, verdict = BOMBS[name]
    content = make()
    assert len(content) < 130e6 if name == "cameras of nothing" else len(content) < 5e6
    outcome = attempt(read, content)
    assert (outcome.verdict, outcome.detail if outcome.faulty else "") == (verdict, "")
    assert outcome.peak_mib < MOST_MIB + len(content) / 2**20
