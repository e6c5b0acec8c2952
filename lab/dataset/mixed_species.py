"""Mix the parameters of several species, so that a network cannot recognise a tree by its species.

Only training species are crossed; held-out species stay unseen.
"""

import math
from dataclasses import replace

import numpy as np

from lab.dataset.species import SPECIES, Foliage, LeafKind, Level, Species

MIXED_SPECIES = "crossed"
DEPTHS = ((2, 0.25), (3, 0.6), (4, 0.15))
"""Numbers of branching levels, with the trunk's, and their probabilities."""
BARE_SHARE = 0.15
CLUMP_SHARE = 0.2  # share of low-poly trees, with foliage in closed clumps
CLUMPS = (0.3, 40.0)  # number of branches with a clump; below 1, only the trunk has one
CLUMP_SIZE = ((0.06, 0.25), (0.15, 0.35))  # radius over the tree's height; the second range is for a single clump
CLUMP_ASPECT = (0.6, 1.4)
STOUTNESS = (0.7, 3.0)  # factor on the trunk's radius of a tree with clumps
LEAF_SIZE, LEAF_ASPECT = (0.016, 0.08), (0.1, 1.0)
"""Length over the tree's height, and width over length; uniform in logarithms."""
KINDS: tuple[LeafKind, ...] = ("leaf", "cluster", "needle")
MAX_STEMS, MAX_LEAVES = 700, 4000
"""Number on parents of full length; the dataset's species have 80 to 640 stems and up to 1,700 leaves."""
BARE_TRUNK, MAX_BRANCH = (0.05, 0.9), 0.9
"""Bare share of the trunk's length, and a branch's largest length over its parent's."""
TRUNK_TAPER, BRANCH_TAPER = (0.25, 1.0), (0.6, 1.0)
"""Share of the radius lost from base to tip; a stem with little taper bends at its base and moves its tip further."""
RATIO_POWER = (0.9, 2.4)
"""Range of the exponent of a child's relative radius in its relative length: from stout twigs to a willow's strands."""
HANGING_SHARE = 0.15
"""Share of trees with hanging strands, as willows have."""
HANGING_TROPISM, STRAND_LENGTH, STRAND_SEGMENTS = (1.2, 3.5), (0.4, MAX_BRANCH), 7
FLARE = (0.02, 0.8)
"""Widening of the trunk at the ground, which differs widely in models of trees."""


def mix_species(rng: np.random.Generator) -> Species:
    """Mix species: the trunk of one, branches and leaves of others; or create a low-poly tree."""
    parents = [species for species in SPECIES.values() if not species.held_out]
    frame = _one_of(parents, rng)
    if rng.random() < CLUMP_SHARE:
        return _low_poly_species(frame, rng)
    num_levels = int(rng.choice([depth for depth, _ in DEPTHS], p=[share for _, share in DEPTHS]))
    levels, stems = [replace(frame.levels[0], taper=float(rng.uniform(*TRUNK_TAPER)))], 1.0
    for depth in range(1, num_levels):
        bearing = [species for species in parents if len(species.levels) > depth]
        level = _changed(_one_of(bearing, rng).levels[depth], rng)
        level = replace(level, count=min(level.count, MAX_STEMS / stems))
        levels.append(level)
        stems *= level.count
    if rng.random() < HANGING_SHARE:
        strands = (-_draw(HANGING_TROPISM, rng), _draw(STRAND_LENGTH, rng))
        levels[-1] = replace(levels[-1], tropism=strands[0], length=strands[1], segments=STRAND_SEGMENTS, sides=3)
    return replace(
        frame,
        name=MIXED_SPECIES,
        shape=_one_of(parents, rng).shape,
        base_size=_draw(BARE_TRUNK, rng),
        ratio=frame.ratio * _factor(1.5, rng),
        levels=tuple(levels),
        foliage=_leaves(parents, stems, num_levels, rng),
        ratio_power=_draw(RATIO_POWER, rng),
        flare=_draw(FLARE, rng),
    )


def _low_poly_species(frame: Species, rng: np.random.Generator) -> Species:
    """Create a low-poly tree: a trunk, some branches or none, and closed clumps of foliage."""
    levels = [replace(frame.levels[0], taper=float(rng.uniform(*TRUNK_TAPER)))]
    count = _draw(CLUMPS, rng)
    if count >= 1:
        levels.append(replace(_changed(frame.levels[1], rng), count=count, splits=0.0))
    size = CLUMP_SIZE[0] if count >= 1 else CLUMP_SIZE[1]
    return replace(
        frame,
        name=MIXED_SPECIES,
        base_size=_draw(BARE_TRUNK, rng),
        ratio=frame.ratio * _draw(STOUTNESS, rng),
        levels=tuple(levels),
        foliage=replace(frame.foliage, kind="clump", size=_draw(size, rng), aspect=_draw(CLUMP_ASPECT, rng)),
        ratio_power=_draw(RATIO_POWER, rng),
        flare=_draw(FLARE, rng),
    )


def _leaves(parents: list[Species], stems: float, num_levels: int, rng: np.random.Generator) -> Foliage:
    if rng.random() < BARE_SHARE:
        return Foliage(kind="none")
    own = _one_of([species for species in parents if species.foliage.kind != "none"], rng).foliage
    aspect = _draw(LEAF_ASPECT, rng)
    more = (4.0 if num_levels == 2 else 1.0) / math.sqrt(aspect)  # long branches that bear the leaves
    return replace(
        own,
        kind=KINDS[int(rng.integers(len(KINDS)))],
        count=min(own.count * more * _factor(1.7, rng), MAX_LEAVES / stems),
        size=_draw(LEAF_SIZE, rng),
        aspect=aspect,
        down=float(rng.uniform(20, 75)),
        droop=float(rng.uniform(0, 0.8)),
    )


def _changed(level: Level, rng: np.random.Generator) -> Level:
    return replace(
        level,
        length=min(level.length * _factor(1.8, rng), MAX_BRANCH),
        count=level.count * _factor(1.7, rng),
        curve=level.curve + float(rng.normal(0, 35)),
        down=float(np.clip(level.down * _factor(1.3, rng), 15, 115)),
        tropism=level.tropism + float(rng.normal(0, 1.2)),
        taper=float(rng.uniform(*BRANCH_TAPER)),
    )


def _factor(largest: float, rng: np.random.Generator) -> float:
    return _draw((1 / largest, largest), rng)


def _draw(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw between two values, uniform in the logarithm."""
    return math.exp(float(rng.uniform(math.log(bounds[0]), math.log(bounds[1]))))


def _one_of(species: list[Species], rng: np.random.Generator) -> Species:
    return species[int(rng.integers(len(species)))]
