"""Detect and triangulate printed AprilTags (family 36h11) in posed photos, with the AprilTag library (BSD) and COLMAP.

Only the child process of `mapping` imports this module, since it is native code.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pycolmap
from jaxtyping import Float64, UInt8
from pyapriltags import Detector

from dynamictree.reconstruct.markers import Marker

FAMILY = "tag36h11"


class Sighting(NamedTuple):
    """Markers detected in an undistorted photo: corners [px] by number."""

    camera: pycolmap.Camera
    cam_from_world: pycolmap.Rigid3d
    corners: dict[int, Float64[np.ndarray, "4 2"]]


class MarkerFinder:
    """Detector of AprilTags, prepared once."""

    def __init__(self) -> None:
        self._detector = Detector(families=FAMILY, quad_decimate=1.0)  # 2 makes corners half as exact

    def find(self, grey: UInt8[np.ndarray, "H W"]) -> dict[int, Float64[np.ndarray, "4 2"]]:
        """Detect markers; return their corners [px] by number, in order around the square, always from the same corner.

        Markers with a wrong bit are ignored, and so are those whose number appears twice, which are ambiguous.
        """
        least_margin = 30.0  # the library's `decision_margin`: markers in photos have 50 and more, similar leaves 10
        seen = [
            (int(tag.tag_id), np.array(tag.corners, np.float64))
            for tag in self._detector.detect(np.ascontiguousarray(grey))
            if tag.hamming == 0 and tag.decision_margin >= least_margin
        ]
        numbers = [number for number, _ in seen]
        return {number: corners for number, corners in seen if numbers.count(number) == 1}


def placed_markers(sightings: Sequence[Sighting]) -> list[Marker]:
    """Triangulate markers on which three photos, and half of those that show them, agree; most photos first."""
    numbers = sorted({number for sighting in sightings for number in sighting.corners})
    markers = [_placed(number, [one for one in sightings if number in one.corners]) for number in numbers]
    return sorted((marker for marker in markers if marker is not None), key=lambda marker: -marker.num_photos)


def _placed(number: int, sightings: Sequence[Sighting]) -> Marker | None:
    largest_spread = 0.1  # relative difference of the longest and shortest edge; more means no square or wrong cameras
    fits_px = 2.0  # reprojection error of a corner
    least_views = 3
    options = pycolmap.EstimateTriangulationOptions()
    options.residual_type = pycolmap.TriangulationResidualType.REPROJECTION_ERROR
    options.ransac.max_error, options.ransac.random_seed = fits_px, 0
    cameras, poses = [one.camera for one in sightings], [one.cam_from_world for one in sightings]
    seen = np.array([one.corners[number] for one in sightings])  # [V, 4, 2]
    estimates = [pycolmap.estimate_triangulation(seen[:, corner], poses, cameras, options) for corner in range(4)]
    corners = [one for one in estimates if one is not None]
    fits = np.all([one["inliers"] for one in corners], axis=0)
    if len(corners) < 4 or fits.sum() < max(least_views, len(sightings) / 2):
        return None
    places = np.array([one["xyz"] for one in corners])
    edges = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
    if np.ptp(edges) > largest_spread * edges.mean():
        return None
    return Marker(number=number, edge=float(edges.mean()), num_photos=int(fits.sum()))
