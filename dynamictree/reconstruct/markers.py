"""Scale from a printed marker of known size, which photos alone do not tell."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SHEET_EDGES_M = {584: 0.05, 585: 0.1, 586: 0.15}
"""Edge of the black square of the markers on our sheet, by number: the last ones of 36h11, which few use."""


@dataclass(frozen=True, kw_only=True)
class Marker:
    """A marker placed by several photos."""

    number: int
    edge: float  # of its black square, in the unit of the cameras
    num_photos: int


def metres_per_unit(markers: Sequence[Marker]) -> float | None:
    """From the markers of the sheet; the mean by the number of photos. None without any."""
    of_sheet = [marker for marker in markers if marker.number in SHEET_EDGES_M]
    if not of_sheet:
        return None
    scales = [SHEET_EDGES_M[marker.number] / marker.edge for marker in of_sheet]
    return float(np.average(scales, weights=[marker.num_photos for marker in of_sheet]))
