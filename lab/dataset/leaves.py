"""Leaves and leaf clusters as cards on stems. Weber and Penn 1995, section 4.6."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from lab.dataset.branching import Stems, normalised, perpendicular, rotate
from lab.dataset.species import Foliage
from lab.dataset.tubes import Surface

LOWEST_M = 0.01  # lowest height of leaves, since only roots are at z = 0
DOWN = np.array([[0, 0, -1]], np.float32)


@dataclass(frozen=True, kw_only=True)
class Leaves:
    """Leaf cards; each rotates about its base, which is fixed to a stem."""

    base: Float32[np.ndarray, "Q 3"]  # position on the stem's axis [m]
    axis: Float32[np.ndarray, "Q 3"]  # unit vector from base to tip
    normal: Float32[np.ndarray, "Q 3"]
    length_m: Float32[np.ndarray, " Q"]
    level: int  # level of the stems that bear them
    row: Int32[np.ndarray, " Q"]
    ring: Float32[np.ndarray, " Q"]


def grow_leaves(foliage: Foliage, height_m: float, stems: Stems, level: int, rng: np.random.Generator) -> Leaves:
    """Grow leaves along every stem of one level, in a spiral; a frond's leaflets in two rows."""
    own = 1 - np.maximum(stems.first / stems.segments, 0.15)
    longest = np.percentile(stems.length_m, 80)
    wanted = foliage.count * own / 0.85 * np.clip(0.3 + 0.7 * stems.length_m / longest, 0, 1.4)
    number = np.floor(wanted + rng.uniform(0, 1, len(wanted))).astype(np.int32)
    row = np.repeat(np.arange(len(number), dtype=np.int32), number)
    within = np.arange(len(row)) - np.repeat(np.cumsum(number) - number, number)
    step = (within + 1) / number[row]
    ring = np.minimum((1 - own[row] * (1 - step)) * stems.segments, stems.segments - 1e-3).astype(np.float32)
    segment = ring.astype(np.int32)
    low, high = stems.points[row, segment], stems.points[row, segment + 1]
    along, share = normalised(high - low), (ring - segment)[:, None]

    rows = foliage.kind in ("frond", "needle")
    azimuth = within * np.pi if rows else within * np.deg2rad(137.5)
    azimuth = azimuth + rng.normal(0, 0.15 if rows else 0.5, len(row))
    side = rotate(perpendicular(along), along, azimuth.astype(np.float32))
    down = np.deg2rad(foliage.down * (1 + 0.25 * rng.uniform(-1, 1, len(row))))
    down = np.where(step > 0.999, 0.25 * down, down)  # the last leaf continues the stem
    axis = normalised(along * np.cos(down)[:, None] + side * np.sin(down)[:, None])
    axis = normalised(axis + foliage.droop * rng.uniform(0.5, 1.5, (len(row), 1)) * DOWN)
    length = foliage.size * height_m * rng.uniform(0.7, 1.3, len(row))
    axis[:, 2] = np.where(low[:, 2] + 1.2 * length * axis[:, 2] < 0, np.abs(axis[:, 2]), axis[:, 2])  # keeps z >= 0
    flat = perpendicular(axis)  # horizontal, so that the card faces up
    normal = rotate(np.cross(axis, flat).astype(np.float32), axis, rng.normal(0, 0.5, len(row)).astype(np.float32))
    if foliage.kind == "frond":
        length *= np.sin(np.pi * np.clip(0.12 + 0.8 * step, 0, 1))
    return Leaves(
        base=((1 - share) * low + share * high).astype(np.float32),
        axis=axis,
        normal=normal,
        length_m=length.astype(np.float32),
        level=level,
        row=row,
        ring=ring,
    )


CARD = {  # (along the axis, across, off the plane) [lengths, widths]; folded along the midrib
    "leaf": np.array([[0, 0, 0], [0.45, 0.5, 0.06], [1, 0, 0], [0.45, -0.5, 0.06]], np.float32),
    "blade": np.array([[0, 0.35, 0], [0.6, 0.5, 0.03], [1, 0, -0.08], [0.6, -0.5, 0.03], [0, -0.35, 0]], np.float32),
    "spray": np.array(
        [[0, 0, 0], [0.35, 0.5, 0.05], [1, 0.28, -0.05], [1, -0.28, -0.05], [0.35, -0.5, 0.05]], np.float32
    ),
}


def cards(leaves: Leaves, foliage: Foliage) -> Surface:
    """Return the leaves' surface; node q is leaf q. A cluster's card is a spray."""
    outline = CARD[{"leaf": "leaf", "frond": "blade"}.get(foliage.kind, "spray")]
    spokes = np.array([[0, corner, corner + 1] for corner in range(1, len(outline) - 1)], np.int32)
    side = np.cross(leaves.normal, leaves.axis)
    frame = np.stack([leaves.axis, side * foliage.aspect, leaves.normal], axis=1)  # [Q, 3, 3]
    placed = leaves.base[:, None] + leaves.length_m[:, None, None] * np.einsum("pa,qax->qpx", outline, frame)
    placed[:, :, 2] = np.maximum(placed[:, :, 2], LOWEST_M)
    count = len(frame)
    return Surface(
        vertices=placed.reshape(-1, 3).astype(np.float32),
        faces=(np.arange(count)[:, None, None] * len(outline) + spokes).reshape(-1, 3).astype(np.int32),
        node=np.repeat(np.arange(count, dtype=np.int32), len(outline)),
    )
