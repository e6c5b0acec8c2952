"""Directions in which registered photos surround the plant, and the largest gap between neighbouring cameras."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8
from PIL import Image, ImageDraw

from dynamictree.reconstruct.photo_cameras import nearest_to_axes
from dynamictree.render.camera import Camera

LARGEST_GAP_DEG = 40.0
"""The advice is a photo every 10 to 20°; SIFT matches two views up to 30 to 40° apart (Lowe 2004, section 5)."""

_MARGIN, _DOT = 0.16, 0.025  # [share of the drawing's side]
_WHITE, _GREY, _BLUE, _RED = (255, 255, 255), (120, 120, 120), (30, 90, 200), (250, 205, 200)


@dataclass(frozen=True, kw_only=True)
class CameraCircle:
    """Registered cameras seen from above the plant, in the order of their azimuths."""

    photos: tuple[str, ...]
    azimuths_deg: Float64[np.ndarray, " V"]  # [0, 360), counter-clockwise from +X

    @property
    def gaps_deg(self) -> Float64[np.ndarray, " V"]:
        """Angle from each camera to the next one; a full circle for a single camera."""
        return np.diff(self.azimuths_deg, append=self.azimuths_deg[:1] + 360)

    @property
    def largest_gap_deg(self) -> float:
        """Largest angle between neighbouring cameras; 360 if no camera sees the plant from its side."""
        return float(self.gaps_deg.max(initial=0)) if self.photos else 360.0

    @property
    def beside_gap(self) -> tuple[str, str]:
        """Names of the photos at both ends of the largest gap; empty names without any camera."""
        if not self.photos:
            return "", ""
        row = int(np.argmax(self.gaps_deg))
        return self.photos[row], self.photos[(row + 1) % len(self.photos)]


def camera_circle(cameras: Mapping[str, Camera]) -> CameraCircle:
    """Compute the azimuths of cameras around the point nearest to all viewing axes, in a frame with +Z up.

    Cameras that look down more steeply than 60° show no side of the plant and are left out.

    Args:
        cameras: cameras by the name of their photo.
    """
    steepest = 0.5  # cosine of 60°: a camera above the plant shows no side of it
    positions = np.array([camera.position_m for camera in cameras.values()])
    offset = positions - nearest_to_axes(cameras.values())
    level = np.linalg.norm(offset[:, :2], axis=1) >= steepest * np.linalg.norm(offset, axis=1)
    azimuths = np.degrees(np.arctan2(offset[:, 1], offset[:, 0])) % 360
    rows = np.flatnonzero(level)
    rows = rows[np.argsort(azimuths[rows], kind="stable")]
    names = list(cameras)
    return CameraCircle(photos=tuple(names[row] for row in rows), azimuths_deg=azimuths[rows])


def coverage_warnings(circle: CameraCircle, num_registered: int, num_photos: int) -> list[str]:
    """Warn of photos without a camera, and of a side of the plant that no photo shows."""
    least_registered = 2 / 3  # share of the photos; with fewer cameras, sides of the plant are missing
    warnings = []
    if num_registered < least_registered * num_photos:
        warnings.append(
            f"{num_registered} of {num_photos} photos have a camera: what only the others show is missing; "
            "left_out_because tells why; take more photos, one every 10 to 20 degrees"
        )
    if circle.largest_gap_deg > LARGEST_GAP_DEG:
        first, second = circle.beside_gap
        warnings.append(
            f"no photo was taken in {circle.largest_gap_deg:.0f} degrees of the circle, between {first} and {second}: "
            "that side of the plant is a guess; report.png shows where to take more photos"
        )
    return warnings


def circle_picture(circle: CameraCircle, side_px: int) -> UInt8[np.ndarray, "S S 3"]:
    """Draw cameras as dots around the plant, seen from above; a gap above `LARGEST_GAP_DEG` is a red sector."""
    image = Image.new("RGB", (side_px, side_px), _WHITE)
    draw = ImageDraw.Draw(image)
    middle, radius, dot = side_px / 2, (0.5 - _MARGIN) * side_px, _DOT * side_px
    ring = (middle - radius, middle - radius, middle + radius, middle + radius)
    for start, gap in zip(circle.azimuths_deg, circle.gaps_deg, strict=True):
        if gap > LARGEST_GAP_DEG:
            draw.pieslice(ring, -(start + gap), -start, fill=_RED)  # PIL's angles are clockwise
    draw.ellipse(ring, outline=_GREY)
    draw.ellipse((middle - dot, middle - dot, middle + dot, middle + dot), fill=_GREY)
    for azimuth in np.radians(circle.azimuths_deg):
        x, y = middle + radius * np.cos(azimuth), middle - radius * np.sin(azimuth)
        draw.ellipse((x - dot, y - dot, x + dot, y + dot), fill=_BLUE)
    first, second = circle.beside_gap
    text = f"largest gap {circle.largest_gap_deg:.0f} deg\n{first} to {second}"
    draw.multiline_text((0.03 * side_px, 0.02 * side_px), text, fill=(0, 0, 0), font_size=max(10, side_px // 24))
    return np.asarray(image)
