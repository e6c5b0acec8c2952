"""The wind of the training data on a skeleton that our generator did not grow: what a model learned of it should do."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Int32, Int64

from dynamictree.spectrum import Wind
from lab.dataset.branching import Stems
from lab.dataset.motion import vertex_spectrum
from lab.dataset.tubes import own_rings
from lab.dataset.wind import sway_stems
from lab.evaluation.procedural_wind import Bones


def simulated(
    bones: Bones, vertices: Float32[np.ndarray, "N 3"], bone: Int32[np.ndarray, " N"], wind: Wind, seed: int
) -> Complex64[np.ndarray, "N K 3"]:
    """Spectrum of vertices, each with its bone, of a tree in leaf [m]. Leaves go with their twig."""
    levels, node = stems_of(bones)
    motion = sway_stems(levels, wind, np.random.default_rng(seed), bare=False)
    return vertex_spectrum(motion, vertices, node[bone])


def stems_of(bones: Bones) -> tuple[tuple[Stems, ...], Int32[np.ndarray, " B"]]:
    """Stems by level, and the node at the head of each bone. A stem with the last bones of a level's is a split."""
    bones_of = [np.flatnonzero(bones.stem == stem) for stem in range(int(bones.stem.max()) + 1)]
    above = [int(bones.parent[own[0]]) for own in bones_of]
    segments: list[int] = []  # of each level: the most bones that a stem of it has
    level, first = np.zeros(len(bones_of), np.int32), np.zeros(len(bones_of), np.int32)
    for stem, own in enumerate(bones_of):
        if above[stem] < 0:
            level[stem] = 0
        else:
            bearer = bones.stem[above[stem]]
            ring = int(first[bearer] + bones.step[above[stem]] + 1)
            is_split = len(own) == segments[level[bearer]] - ring
            level[stem], first[stem] = (level[bearer], ring) if is_split else (level[bearer] + 1, 0)
        if level[stem] == len(segments):
            segments.append(0)
        segments[level[stem]] = max(segments[level[stem]], int(first[stem]) + len(own))
    node = np.zeros(len(bones.head), np.int32)
    levels, start = [], 0
    for depth, count in enumerate(segments):
        rows = np.flatnonzero(level == depth)
        bearers = _Bearers(rows=np.flatnonzero(level == depth - 1), segments=segments[depth - 1], first=first)
        stems = _level(bones, bones_of, rows, bearers, count)
        own = own_rings(stems)
        number: Int64[np.ndarray, "_ _"] = start + np.cumsum(own).reshape(own.shape) - 1
        for stem, of_stem in zip(rows.tolist(), number, strict=True):
            heads = np.linspace(first[stem], count, len(bones_of[stem]), endpoint=False)
            node[bones_of[stem]] = of_stem[np.round(heads).astype(np.int64)]
        start += int(own.sum())
        levels.append(stems)
    return tuple(levels), node


@dataclass(frozen=True, kw_only=True)
class _Bearers:
    """The stems of the level before, and on which ring each stem of the tree begins."""

    rows: Int64[np.ndarray, " L"]
    segments: int
    first: Int32[np.ndarray, " S"]


def _level(
    bones: Bones,
    bones_of: list[Int64[np.ndarray, " _"]],
    rows: Int64[np.ndarray, " M"],
    bearers: _Bearers,
    segments: int,
) -> Stems:
    """The stems of one level. One with fewer bones than its level has segments is divided evenly."""
    first = bearers.first
    points = np.zeros((len(rows), segments + 1, 3), np.float32)
    radii = np.zeros((len(rows), segments + 1), np.float32)
    parent, ring = np.full(len(rows), -1, np.int32), np.zeros(len(rows), np.float32)
    length = np.zeros(len(rows), np.float32)
    for row, stem in enumerate(rows.tolist()):
        own, start = bones_of[stem], int(first[stem])
        above = int(bones.parent[own[0]])
        place = np.linspace(0, len(own), segments - start + 1)
        corners = np.concatenate([bones.head[own], bones.tail[own[-1:]]])
        points[row, start:] = np.stack([np.interp(place, np.arange(len(corners)), axis) for axis in corners.T], axis=1)
        radii[row, start:] = np.interp(place, np.arange(len(own)), bones.radius[own])
        length[row] = np.linalg.norm(np.diff(points[row, start:], axis=0), axis=1).sum()
        if start:
            parent[row], ring[row] = np.searchsorted(rows, bones.stem[above]), start
            points[row, :start], radii[row, :start] = points[parent[row], :start], radii[parent[row], :start]
        elif above >= 0:
            bearer, along = int(bones.stem[above]), bones.tail[above] - bones.head[above]
            share = np.clip((bones.head[own[0]] - bones.head[above]) @ along / (along @ along), 0, 0.99)
            parent[row] = np.searchsorted(bearers.rows, bearer)
            begin, count = int(first[bearer]), len(bones_of[bearer])
            ring[row] = begin + (bearers.segments - begin) * (bones.step[above] + share) / count
    return Stems(
        points=points,
        radii=radii,
        first=first[rows],
        parent=parent,
        parent_ring=ring,
        length_m=length,
        sides=3,
    )
