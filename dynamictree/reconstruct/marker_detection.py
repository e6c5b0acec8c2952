"""Corners of printed AprilTags (family 36h11) in a picture, by the AprilTag library (BSD).

Only the process of `mapping` imports this: it is native code.
"""

from typing import TypedDict

import numpy as np
from jaxtyping import UInt8
from pyapriltags import Detector

FAMILY = "tag36h11"
_LEAST_MARGIN = 30.0  # of the library's scale: markers in photos have 50 and more, leaves that look like one 10


class MarkerCorners(TypedDict):
    """A marker in a picture, as JSON carries it."""

    number: int
    corners_px: list[list[float]]  # [4, 2]: x and y; always the same corner first, then round the square


class MarkerFinder:
    """The prepared detector."""

    def __init__(self) -> None:
        self._detector = Detector(families=FAMILY, quad_decimate=1.0)  # in half the pixels, corners are half as exact

    def find(self, grey: UInt8[np.ndarray, "H W"]) -> list[MarkerCorners]:
        """Markers that are read without a wrong bit; none whose number is there twice, since both may be meant."""
        markers = [
            MarkerCorners(number=int(seen.tag_id), corners_px=seen.corners.tolist())
            for seen in self._detector.detect(np.ascontiguousarray(grey))
            if seen.hamming == 0 and seen.decision_margin >= _LEAST_MARGIN
        ]
        numbers = [marker["number"] for marker in markers]
        return [marker for marker in markers if numbers.count(marker["number"]) == 1]
