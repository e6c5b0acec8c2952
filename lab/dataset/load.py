"""Load of each stem: foliage, branches, and their sideways offset."""

import numpy as np
from jaxtyping import Float32, Float64

from lab.dataset.branching import Stems
from lab.dataset.leaves import Leaves
from lab.dataset.oscillator import WIDEST_LOAD, Load


def loads_of(levels: tuple[Stems, ...], leaves: tuple[Leaves, ...], *, bare: bool) -> list[Load]:
    """Return the loads by level. In a tree with clumps of foliage, all stems bear as much as the trunk."""
    wood = [np.pi * base_radius(stems).astype(np.float64) ** 2 * stems.length_m / 3 for stems in levels]
    foliage = [np.zeros(len(stems.points)) for stems in levels]
    weighted = [own[:, None] * ring_centre(stems) for own, stems in zip(wood, levels, strict=True)]
    borne = [own.copy() for own in wood]
    for bunch in leaves:
        area = bunch.length_m.astype(np.float64) ** 2
        np.add.at(foliage[bunch.level], bunch.row, area)
    for depth in range(len(levels) - 1, -1, -1):
        stems = levels[depth]
        for first in sorted(set(stems.first.tolist()), reverse=True):
            rows = np.flatnonzero(stems.first == first)
            if first == 0 and depth == 0:
                continue
            above = depth if first else depth - 1
            for sums in (foliage, weighted, borne):
                np.add.at(sums[above], stems.parent[rows], sums[depth][rows])
    loads = []
    for depth, stems in enumerate(levels):
        section = foliage[depth] / base_radius(stems) ** 2
        if depth == 0:
            rooted = stems.first == 0
            whole = foliage[0][rooted].sum() / (base_radius(stems)[rooted] ** 2).sum()
        share = np.clip(section / whole, 0, 1) if whole > 0 and depth else np.full(len(section), 0.0 if bare else 1.0)
        offset = (weighted[depth] / borne[depth][:, None] - ring_centre(stems)) / stems.length_m[:, None]
        far = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True) / WIDEST_LOAD, 1)
        loads.append(
            Load(
                foliage=share.astype(np.float32),
                branches=(1 - wood[depth] / borne[depth]).astype(np.float32),
                offset=(offset / far).astype(np.float32),
            )
        )
    return loads


def base_radius(stems: Stems) -> Float32[np.ndarray, " M"]:
    """Return the radius at a stem's base [m]."""
    radius: Float32[np.ndarray, " M"] = stems.radii[np.arange(len(stems.points)), stems.first]
    return radius


def ring_centre(stems: Stems) -> Float64[np.ndarray, "M 3"]:
    """Return the mean position of a stem's own rings [m]."""
    own = np.arange(stems.segments + 1) >= stems.first[:, None]
    middle: Float64[np.ndarray, "M 3"] = (stems.points * own[:, :, None]).sum(axis=1) / own.sum(axis=1)[:, None]
    return middle
