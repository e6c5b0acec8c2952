"""The wind of the training data on a skeleton that our generator did not grow: what a model learned of it should do."""

import numpy as np
from jaxtyping import Complex64, Float32, Int32, Int64

from dynamictree.dataset.branching import Stems
from dynamictree.dataset.motion import vertex_spectrum
from dynamictree.dataset.tubes import own_rings
from dynamictree.dataset.wind import sway_stems
from dynamictree.evaluation.procedural_wind import Bones
from dynamictree.spectrum import Wind


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
    segments: list[int] = []
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
            segments.append(len(own))
    node = np.zeros(len(bones.head), np.int32)
    levels, start = [], 0
    for depth, count in enumerate(segments):
        rows = np.flatnonzero(level == depth)
        stems = _level(bones, [bones_of[stem] for stem in rows], rows, first, np.flatnonzero(level == depth - 1), count)
        own = own_rings(stems)
        number: Int64[np.ndarray, "_ _"] = start + np.cumsum(own).reshape(own.shape) - 1
        for stem_row, of_stem in zip(rows.tolist(), number, strict=True):
            node[bones_of[stem_row]] = of_stem[first[stem_row] : -1]
        start += int(own.sum())
        levels.append(stems)
    return tuple(levels), node


def _level(
    bones: Bones,
    bones_of: list[Int64[np.ndarray, " _"]],
    rows: Int64[np.ndarray, " M"],
    first: Int32[np.ndarray, " S"],
    below: Int64[np.ndarray, " L"],
    segments: int,
) -> Stems:
    """The stems of one level; `below` are those of the level before."""
    points = np.zeros((len(rows), segments + 1, 3), np.float32)
    radii = np.zeros((len(rows), segments + 1), np.float32)
    parent, ring = np.full(len(rows), -1, np.int32), np.zeros(len(rows), np.float32)
    length = np.zeros(len(rows), np.float32)
    for row, (stem, own) in enumerate(zip(rows, bones_of, strict=True)):
        start, above = int(first[stem]), int(bones.parent[own[0]])
        points[row, start:-1], points[row, -1] = bones.head[own], bones.tail[own[-1]]
        radii[row, start:-1], radii[row, -1] = bones.radius[own], bones.radius[own[-1]]
        length[row] = np.linalg.norm(np.diff(points[row, start:], axis=0), axis=1).sum()
        if start:
            parent[row], ring[row] = np.searchsorted(rows, bones.stem[above]), start
            points[row, :start], radii[row, :start] = points[parent[row], :start], radii[parent[row], :start]
        elif above >= 0:
            bearer, along = bones.stem[above], bones.tail[above] - bones.head[above]
            share = (bones.head[own[0]] - bones.head[above]) @ along / (along @ along)
            parent[row] = np.searchsorted(below, bearer)
            ring[row] = first[bearer] + bones.step[above] + np.clip(share, 0, 0.99)
    return Stems(
        points=points,
        radii=radii,
        first=first[rows],
        parent=parent,
        parent_ring=ring,
        length_m=length,
        sides=3,
    )
