"""Names of a file's up axis: an axis such as `-Y`, or a direction such as `0.17,-0.97,0.17`."""

import math
import re
from collections.abc import Sequence

from dynamictree.errors import InputError

AXES = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")
_NUMBER = r"-?[0-9]+(\.[0-9]+)?"
DIRECTION_PATTERN = f"{_NUMBER},{_NUMBER},{_NUMBER}"
UP_AXIS_PATTERN = rf"[+-][XYZ]|{DIRECTION_PATTERN}"
Direction = tuple[float, float, float]
"""A unit vector."""


def direction_of(name: str) -> Direction:
    """Return the unit vector of a named axis or direction.

    Raises:
        InputError: the name is no axis and no direction, or the direction has no length.
    """
    shortest = 1e-3  # length of the shortest direction that is accepted
    if not re.fullmatch(UP_AXIS_PATTERN, name):
        raise InputError(f"up_axis is {name[:80]!r}; choose from {', '.join(AXES)}, or a direction as 0.17,-0.97,0.17")
    if name in AXES:
        sign = 1.0 if name[0] == "+" else -1.0
        return (sign * (name[1] == "X"), sign * (name[1] == "Y"), sign * (name[1] == "Z"))
    numbers = [float(number) for number in name.split(",")]
    length = math.hypot(*numbers)
    if not shortest <= length < math.inf:
        raise InputError(f"up_axis is {name[:80]!r}; a direction has a length, such as 0.17,-0.97,0.17")
    x, y, z = (number / length for number in numbers)
    return x, y, z


def name_of(direction: Sequence[float]) -> str:
    """Return the name of a direction of any length, exact to 0.01°; `direction_of` is the inverse."""
    digits = 4  # decimals of a unit vector's coordinates, exact to 0.01°
    length = math.hypot(*direction)
    unit = tuple(round(number / length, digits) + 0.0 for number in direction)  # no minus zero
    axis = next((name for name in AXES if direction_of(name) == unit), None)
    return axis or ",".join(f"{number:.{digits}f}".rstrip("0").rstrip(".") for number in unit)
