"""Scale from a printed marker of known size, which photos alone do not tell."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float64

from dynamictree.reconstruct.photo_cameras import nearest_to_axes
from dynamictree.reconstruct.views import View

SHEET_EDGES_M = {584: 0.05, 585: 0.1, 586: 0.15}
"""Edge of the black square of the markers on our sheet, by number: the last ones of 36h11, which few use."""

_LEAST_VIEWS = 3
_FITS_PX = 2.0  # between a corner and where a photo has it
_MOST_PAIRS = 60  # of photos that are tried
_LARGEST_SPREAD = 0.1  # between the longest and the shortest edge: more is no square, or cameras are wrong
_ROUNDS = 2  # of placing the corners by all photos that fit


@dataclass(frozen=True, kw_only=True)
class Marker:
    """A marker placed by several photos."""

    number: int
    edge: float  # of its black square, in the unit of the cameras
    num_photos: int


def find_markers(views: Sequence[View]) -> tuple[Marker, ...]:
    """Markers that three photos, and half of those that show them, agree on; those in most photos first."""
    numbers = sorted({number for view in views for number in view.markers})
    markers = [_placed(number, [view for view in views if number in view.markers]) for number in numbers]
    return tuple(sorted((marker for marker in markers if marker is not None), key=lambda marker: -marker.num_photos))


def metres_per_unit(markers: Sequence[Marker]) -> float | None:
    """From the markers of the sheet; the mean by the number of photos. None without any."""
    of_sheet = [marker for marker in markers if marker.number in SHEET_EDGES_M]
    if not of_sheet:
        return None
    scales = [SHEET_EDGES_M[marker.number] / marker.edge for marker in of_sheet]
    return float(np.average(scales, weights=[marker.num_photos for marker in of_sheet]))


def _placed(number: int, views: list[View]) -> Marker | None:
    """Corners where most photos have them: from pairs of photos first, then from all that fit the best pair."""
    if len(views) < _LEAST_VIEWS:
        return None
    seen = np.array([view.markers[number] for view in views])  # [V, 4, 2]
    pairs = list(combinations(range(len(views)), 2))
    tried = [pairs[row] for row in np.unique(np.linspace(0, len(pairs) - 1, _MOST_PAIRS).round().astype(int))]
    errors = np.array([_errors_px(views, seen, _corners(views, seen, list(pair))) for pair in tried])  # [pairs, V]
    best = errors[np.argmin(np.minimum(errors, _FITS_PX).sum(axis=1))]
    for _ in range(_ROUNDS):
        fits = np.flatnonzero(best < _FITS_PX)
        if len(fits) < max(_LEAST_VIEWS, len(views) / 2):
            return None
        corners = _corners(views, seen, fits.tolist())
        best = _errors_px(views, seen, corners)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    edge = float(edges.mean())
    if np.ptp(edges) > _LARGEST_SPREAD * edge:
        return None
    return Marker(number=number, edge=edge, num_photos=len(fits))


def _corners(views: list[View], seen: Float64[np.ndarray, "V 4 2"], rows: list[int]) -> Float64[np.ndarray, "4 3"]:
    """Intersections of the rays from some of the photos."""
    chosen = [views[row] for row in rows]
    return np.stack([_nearest(chosen, seen[rows, corner]) for corner in range(4)])


def _nearest(views: list[View], at_px: Float64[np.ndarray, "V 2"]) -> Float64[np.ndarray, "3"]:
    """The point of least squared distance to the rays through a pixel of each view."""
    origins = np.array([view.camera.position_m for view in views])
    rays = []
    for view, (x, y) in zip(views, at_px, strict=True):
        height, width = view.image.shape[:2]
        ray = np.linalg.solve(view.camera.intrinsics_px(width, height), [x, y, 1.0]) @ view.camera.world_to_camera
        rays.append(ray / np.linalg.norm(ray))
    return nearest_to_axes(origins, np.array(rays))


def _errors_px(
    views: list[View], seen: Float64[np.ndarray, "V 4 2"], corners: Float64[np.ndarray, "4 3"]
) -> Float64[np.ndarray, " V"]:
    """How far the corner that fits worst lies from where each photo has it."""
    errors = np.full(len(views), np.inf)
    for row, view in enumerate(views):
        height, width = view.image.shape[:2]
        projected = view.camera.project(corners, width, height)
        if projected[:, 2].min() > 0:
            errors[row] = np.linalg.norm(projected[:, :2] - seen[row], axis=1).max()
    return errors
