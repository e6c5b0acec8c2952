"""Surface of the stems: one tube per stem; its first ring is inside the parent."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64

from lab.dataset.branching import Stems, normalised, perpendicular


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Part of the mesh; every vertex follows the motion of one node."""

    vertices: Float32[np.ndarray, "N 3"]  # [m]
    faces: Int32[np.ndarray, "F 3"]
    node: Int32[np.ndarray, " N"]


def own_rings(stems: Stems) -> Bool[np.ndarray, "M P"]:
    """Return which rings are a stem's own. Own rings are the nodes, counted row by row."""
    return np.arange(stems.segments + 1) >= stems.first[:, None]


def ring_axes(stems: Stems) -> tuple[Float32[np.ndarray, "M P 3"], Float32[np.ndarray, "M P 3"]]:
    """Return two unit vectors that span each ring, transported along the stem without twist."""
    segment = normalised(np.diff(stems.points, axis=1))  # [M, R, 3]
    tangent = normalised(np.concatenate([segment[:, :1], segment[:, 1:] + segment[:, :-1], segment[:, -1:]], axis=1))
    side = np.empty_like(tangent)
    side[:, 0] = perpendicular(tangent[:, 0])
    for ring in range(1, stems.segments + 1):
        along = (side[:, ring - 1] * tangent[:, ring]).sum(axis=1, keepdims=True)
        side[:, ring] = normalised(side[:, ring - 1] - along * tangent[:, ring])
    return side, np.cross(tangent, side).astype(np.float32)


def tubes(stems: Stems, *, on_ground: bool = False) -> Surface:
    """Build one closed tube per stem; if `on_ground`, the first ring is level, so that the trunk stands on z = 0."""
    own, sides = own_rings(stems), stems.sides
    side, other = ring_axes(stems)
    if on_ground:
        side[:, 0], other[:, 0] = [1, 0, 0], [0, 1, 0]
        turn = np.arctan2(side[:, 1, 1], side[:, 1, 0])  # aligns the ground ring with the next
        side[:, 0] = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
        other[:, 0] = np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], axis=1)
    angle = 2 * np.pi * np.arange(sides, dtype=np.float32) / sides
    around = np.cos(angle)[:, None] * side[:, :, None] + np.sin(angle)[:, None] * other[:, :, None]  # [M, P, S, 3]
    vertices = stems.points[:, :, None] + stems.radii[:, :, None, None] * around
    node = np.cumsum(own).reshape(own.shape) - 1  # [M, P]
    faces = _walls(node[:, :-1][own[:, :-1]], sides)
    tips = _fan(node[:, -1], sides)
    return Surface(
        vertices=vertices[own].reshape(-1, 3).astype(np.float32),
        faces=np.concatenate([faces, tips]).astype(np.int32),
        node=np.repeat(np.arange(own.sum(), dtype=np.int32), sides),
    )


def _walls(lower: Int64[np.ndarray, " B"], sides: int) -> Int64[np.ndarray, "F 3"]:
    """Return two triangles per side of each segment, from ring node `lower` to the next."""
    side = np.arange(sides)
    after = (side + 1) % sides
    a, b = lower[:, None] * sides + side, lower[:, None] * sides + after  # [B, S]
    c, d = a + sides, b + sides
    return np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)], axis=2).reshape(-1, 3)


def _fan(rings: Int64[np.ndarray, " M"], sides: int) -> Int64[np.ndarray, "F 3"]:
    """Return the triangles that close the given ring nodes."""
    spoke = np.stack([np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], axis=1)  # [S-2, 3]
    fans: Int64[np.ndarray, "M S 3"] = rings[:, None, None] * sides + spoke
    return fans.reshape(-1, 3)
