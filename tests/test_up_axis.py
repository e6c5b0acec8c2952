"""Names of directions are those directions, and the turn of a file takes the one it names to +Z."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamictree.axis_names import AXES, direction_of, name_of
from dynamictree.errors import InputError
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation

COORDINATE = st.floats(-1, 1, allow_subnormal=False)
DIRECTION = st.tuples(COORDINATE, COORDINATE, COORDINATE).filter(lambda numbers: np.linalg.norm(numbers) > 0.1)
HUNDREDTH_DEG = np.radians(0.01)


@given(DIRECTION)
def test_a_name_is_its_direction(numbers: tuple[float, float, float]) -> None:
    unit = np.array(numbers) / np.linalg.norm(numbers)
    assert np.linalg.norm(np.array(direction_of(name_of(numbers))) - unit) < HUNDREDTH_DEG
    assert Reading(up_axis=name_of(numbers)).up_axis == name_of(numbers)


@given(DIRECTION)
def test_a_turn_takes_the_direction_up_and_is_the_nearest_axis_turned_least(
    numbers: tuple[float, float, float],
) -> None:
    name = name_of(numbers)
    turn, up = up_rotation(name), np.array(direction_of(name))
    assert np.allclose(turn @ up, [0, 0, 1])
    assert np.allclose(turn @ turn.T, np.eye(3))
    assert np.isclose(np.linalg.det(turn), 1)
    nearest = max(AXES, key=lambda axis: float(np.array(direction_of(axis)) @ up))
    beside = turn @ up_rotation(nearest).T
    assert np.isclose(np.trace(beside), 1 + 2 * (np.array(direction_of(nearest)) @ up))  # its angle is the tilt


def test_axes_are_directions() -> None:
    assert [name_of([7 * number for number in direction_of(axis)]) for axis in AXES] == list(AXES)


@pytest.mark.parametrize(
    "name", ["", "Y", "up", "0,0,0", "1,2", "1,2,3,4", "nan,0,1", "1e3,0,0", "0, 0, 1", "9" * 400 + ",0,0"]
)
def test_what_is_no_direction_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="up_axis"):
        direction_of(name)


@pytest.mark.parametrize("name", ["up", "0,0", "1,2,3,4", "0,0,1;"])
def test_a_request_allows_what_is_read(name: str) -> None:
    with pytest.raises(InputError):
        Reading(up_axis=name)
