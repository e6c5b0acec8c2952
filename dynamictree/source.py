"""What a shape was read from, and how: the files that are made of it record this."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Source:
    """A file of a tree's shape. Empty and None where it is not known."""

    sha256: str = ""  # of the file's bytes
    up_axis: str = ""  # of the file, such as "+Y"; see `up_axis.py`
    up_confidence: float | None = None  # in [0, 1]; below 1 the axis was found from the shape
    scale: float | None = None  # metres in a unit of the file
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)  # subtracted from its coordinates, in its axes and unit
