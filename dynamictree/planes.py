"""Planes in points: least squares, RANSAC, and which points lie flat among their neighbours."""

from collections.abc import Callable, Iterator
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import scipy  # submodules load on first use, so the service starts without them
from jaxtyping import Bool, Float64

Points = Float64[np.ndarray, "_ 3"]
Direction = Float64[np.ndarray, " 3"]

NEIGHBOURS = 12
"""Number of neighbours from whose spread a point's normal is estimated; fewer points have no normals."""
_ALONG = 0.85  # cosine between a plane's normal and a point's


class Plane(NamedTuple):
    """Plane of the points p with normal · p = offset."""

    normal: Direction  # unit vector
    offset: float  # [m]

    def above(self, points: Points) -> Float64[np.ndarray, " P"]:
        """Signed distance of points, positive on the side of the normal [m]."""
        return np.asarray(points @ self.normal - self.offset)

    def facing(self, direction: Direction) -> "Plane":
        """Return the same plane, its normal turned to the side of a direction."""
        sign = 1.0 if self.normal @ direction >= 0 else -1.0
        return Plane(self.normal * sign, self.offset * sign)


def fit_plane(points: Points) -> Plane:
    """Fit a plane by total least squares."""
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    return Plane(normal, float(normal @ middle))


def best_plane(candidates: Iterator[Plane], score: Callable[[Plane], float], least: float) -> Plane | None:
    """Return the candidate with the highest score above `least`, as in RANSAC (Fischler and Bolles 1981)."""
    highest, best = max(((score(plane), plane) for plane in candidates), key=itemgetter(0), default=(least, None))
    return best if highest > least else None


def planes_of_triples(points: Points, trials: int, rng: np.random.Generator) -> Iterator[Plane]:
    """Yield planes through three random points each."""
    for a, b, c in points[rng.integers(0, len(points), (trials, 3))]:
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length > 0:
            yield Plane(normal / length, float(normal @ a) / length)


def support(above: Float64[np.ndarray, " P"], thickness: float) -> float:
    """Score a plane as ground, which has nothing below: number of points on it minus twice the number below."""
    return float((np.abs(above) < thickness).sum() - 2 * (above < -thickness).sum())


class FlatPoints(NamedTuple):
    """Points with their normals, and whether each lies on a flat surface."""

    places: Points
    normals: Points  # unit vectors, sign arbitrary
    flat: Bool[np.ndarray, " P"]

    def on(self, plane: Plane, thickness: float) -> Bool[np.ndarray, " P"]:
        """Mask of the flat points near a plane with normals parallel to the plane's."""
        chosen: Bool[np.ndarray, " P"] = self.flat & (np.abs(plane.above(self.places)) < thickness)
        chosen &= np.abs(self.normals @ plane.normal) > _ALONG
        return chosen

    def planes(self, trials: int, rng: np.random.Generator) -> Iterator[Plane]:
        """Yield tangent planes of flat points, drawn at random."""
        for row in rng.permutation(np.flatnonzero(self.flat))[:trials]:
            yield Plane(self.normals[row], float(self.normals[row] @ self.places[row]))

    def subset(self, rows: Bool[np.ndarray, " P"]) -> "FlatPoints":
        """Return a subset of the points."""
        return FlatPoints(self.places[rows], self.normals[rows], self.flat[rows])


def flat_points(points: Points) -> FlatPoints:
    """Estimate normals as principal axes of each point's neighbours (Hoppe 1992)."""
    near = np.asarray(scipy.spatial.cKDTree(points).query(points, k=NEIGHBOURS)[1])
    flat = 0.25  # largest ratio of the standard deviations across and along a flat surface
    around = points[near] - points[near].mean(axis=1, keepdims=True)  # [P, K, 3]
    spread, axes = np.linalg.eigh(np.einsum("pki,pkj->pij", around, around))
    return FlatPoints(points, axes[:, :, 0], spread[:, 0] < flat**2 * spread[:, 1])
