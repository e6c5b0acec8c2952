"""Shift of coordinates far from the origin, such as a map's, in double precision before they become single."""

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.mesh import SourceWarning

Offset = tuple[float, float, float]
"""Subtracted from the coordinates of a file, in its axes and unit."""


def shift_to_origin(points: Float64[np.ndarray, "N 3"]) -> tuple[Float32[np.ndarray, "N 3"], Offset]:
    """Return points in single precision, and the subtracted offset: integers, 0 for points near the origin.

    Values that are not finite, or too large for single precision, become infinite or NaN.
    """
    far = 100.0  # ratio of distance to extent; float32 then rounds to 1e-5 of the extent, 0.1 mm of a tree of 10 m
    finite = points[np.isfinite(points).all(axis=1)]
    offset = np.zeros(3)
    with np.errstate(over="ignore", invalid="ignore"):
        extent = np.ptp(finite, axis=0).max() if len(finite) else 0.0
        if 0 < extent < np.inf and np.abs(finite).max() > far * extent:
            offset = np.floor((finite.min(axis=0) + finite.max(axis=0)) / 2)
        return (points - offset).astype(np.float32), (float(offset[0]), float(offset[1]), float(offset[2]))


def offset_warnings(offset: Offset) -> tuple[SourceWarning, ...]:
    """Return a warning with the offset, if there is one."""
    if not any(offset):
        return ()
    numbers = ", ".join(f"{number:.0f}" for number in offset)
    message = (
        f"the coordinates lie far from the origin, as of a map; {numbers} (x, y, z of the file) were subtracted, and "
        "all products stand at the origin: add them (`source_offset`) to place the tree on the map"
    )
    return (SourceWarning(code="moved-to-origin", message=message),)
