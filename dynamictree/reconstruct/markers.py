"""Metric scale from printed markers of known size; photos alone give none."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SHEET_EDGES_M = {584: 0.05, 585: 0.1, 586: 0.15}
"""Edge of the black square of the markers on our sheet, by number: the last of 36h11, which are rarely used."""


@dataclass(frozen=True, kw_only=True)
class Marker:
    """Marker triangulated from several photos."""

    number: int
    edge: float  # edge of its black square [units of the cameras]
    num_photos: int


def metres_per_unit(markers: Sequence[Marker]) -> float | None:
    """Return the scale by the sheet's markers, averaged with their number of photos as weights; None without any."""
    of_sheet = [marker for marker in markers if marker.number in SHEET_EDGES_M]
    if not of_sheet:
        return None
    scales = [SHEET_EDGES_M[marker.number] / marker.edge for marker in of_sheet]
    return float(np.average(scales, weights=[marker.num_photos for marker in of_sheet]))
