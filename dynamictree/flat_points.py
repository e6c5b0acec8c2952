"""Points on surfaces: their normals, and which of them lie flat among their neighbours."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial import cKDTree

NEIGHBOURS = 12
"""Whose spread gives the normal; fewer points have none."""
_FLAT = 0.25  # standard deviation across over that along a surface
_ALONG = 0.85  # cosine between a plane's normal and a point's


class FlatPoints(NamedTuple):
    """What the neighbours of each point say."""

    normals: Float64[np.ndarray, "P 3"]  # of either sign
    flat: Bool[np.ndarray, " P"]

    def on_plane(
        self, points: Float64[np.ndarray, "P 3"], normal: Float64[np.ndarray, "3"], offset: float, thickness: float
    ) -> Bool[np.ndarray, " P"]:
        """Flat points within a distance of a plane whose normals are along the plane's."""
        chosen: Bool[np.ndarray, " P"] = self.flat & (np.abs(points @ normal - offset) < thickness)
        chosen &= np.abs(self.normals @ normal) > _ALONG
        return chosen

    def subset(self, rows: Bool[np.ndarray, " P"]) -> "FlatPoints":
        """The same of some points."""
        return FlatPoints(self.normals[rows], self.flat[rows])


def flat_points(points: Float64[np.ndarray, "P 3"]) -> FlatPoints:
    """Normals by the neighbours' principal axes (Hoppe 1992)."""
    near = np.asarray(cKDTree(points).query(points, k=NEIGHBOURS)[1])
    around = points[near] - points[near].mean(axis=1, keepdims=True)  # [P, K, 3]
    spread, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", around, around))
    return FlatPoints(axes[:, :, 0], spread[:, 0] < _FLAT**2 * spread[:, 1])
