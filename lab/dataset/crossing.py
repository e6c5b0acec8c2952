"""Trees that mix the parameters of several species, so that a network cannot recognise a tree by its species.

Only species for training are crossed; what is held out stays unseen.
"""

import math
from dataclasses import replace

import numpy as np

from lab.dataset.species import SPECIES, Foliage, LeafKind, Level, Species

CROSSED = "crossed"
DEPTHS = ((2, 0.25), (3, 0.6), (4, 0.15))
"""Levels of branching, the trunk's included, and how often."""
BARE_SHARE = 0.15
CLUMP_SHARE = 0.2  # of the trees are low-poly: foliage in closed clumps
CLUMPS = (0.3, 40.0)  # branches with a clump each; below one, only the trunk has one
CLUMP_SIZE = ((0.06, 0.25), (0.15, 0.35))  # radius over the tree's height; of one clump alone
CLUMP_ASPECT = (0.6, 1.4)
STOUTNESS = (0.7, 3.0)  # of a trunk that bears clumps, over a species' own
LEAF_SIZE, LEAF_ASPECT = (0.016, 0.08), (0.1, 1.0)
"""Of the tree's height, and width over length; evenly in logarithms."""
KINDS: tuple[LeafKind, ...] = ("leaf", "cluster", "needle")
MAX_STEMS, MAX_LEAVES = 700, 4000
"""On parents of full length; the dataset's species have 80 to 640 and to 1,700."""
BARE_TRUNK, MAX_BRANCH = (0.05, 0.9), 0.9
"""Of the trunk's length, and of the parent's."""
TRUNK_TAPER, BRANCH_TAPER = (0.25, 1.0), (0.6, 1.0)
"""Share of the radius lost from base to tip: what tapers little bends at its base, and carries its tip further."""
RATIO_POWER = (0.9, 2.4)
"""Exponent of a child's radius in its length over its parent's: from stout twigs to strands of a willow."""
HANGING_SHARE = 0.15
"""Of the trees have strands that hang, as willows do."""
HANGING_TROPISM, STRAND_LENGTH, STRAND_SEGMENTS = (1.2, 3.5), (0.4, MAX_BRANCH), 7
FLARE = (0.02, 0.8)
"""Widening of the trunk at the ground: models of trees have any or none."""


def crossed_species(rng: np.random.Generator) -> Species:
    """Mix species: the trunk of one, each level of branches of another, and other leaves; or make a low-poly tree."""
    parents = [species for species in SPECIES.values() if not species.held_out]
    frame = _one_of(parents, rng)
    if rng.random() < CLUMP_SHARE:
        return _clumped(frame, rng)
    num_levels = int(rng.choice([depth for depth, _ in DEPTHS], p=[share for _, share in DEPTHS]))
    levels, stems = [replace(frame.levels[0], taper=float(rng.uniform(*TRUNK_TAPER)))], 1.0
    for depth in range(1, num_levels):
        bearing = [species for species in parents if len(species.levels) > depth]
        level = _changed(_one_of(bearing, rng).levels[depth], rng)
        level = replace(level, count=min(level.count, MAX_STEMS / stems))
        levels.append(level)
        stems *= level.count
    if rng.random() < HANGING_SHARE:
        strands = (-_between(HANGING_TROPISM, rng), _between(STRAND_LENGTH, rng))
        levels[-1] = replace(levels[-1], tropism=strands[0], length=strands[1], segments=STRAND_SEGMENTS, sides=3)
    return replace(
        frame,
        name=CROSSED,
        shape=_one_of(parents, rng).shape,
        base_size=_between(BARE_TRUNK, rng),
        ratio=frame.ratio * _factor(1.5, rng),
        levels=tuple(levels),
        foliage=_leaves(parents, stems, num_levels, rng),
        ratio_power=_between(RATIO_POWER, rng),
        flare=_between(FLARE, rng),
    )


def _clumped(frame: Species, rng: np.random.Generator) -> Species:
    """A low-poly tree: a trunk, some branches or none, and closed clumps of foliage."""
    levels = [replace(frame.levels[0], taper=float(rng.uniform(*TRUNK_TAPER)))]
    count = _between(CLUMPS, rng)
    if count >= 1:
        levels.append(replace(_changed(frame.levels[1], rng), count=count, splits=0.0))
    size = CLUMP_SIZE[0] if count >= 1 else CLUMP_SIZE[1]
    return replace(
        frame,
        name=CROSSED,
        base_size=_between(BARE_TRUNK, rng),
        ratio=frame.ratio * _between(STOUTNESS, rng),
        levels=tuple(levels),
        foliage=replace(frame.foliage, kind="clump", size=_between(size, rng), aspect=_between(CLUMP_ASPECT, rng)),
        ratio_power=_between(RATIO_POWER, rng),
        flare=_between(FLARE, rng),
    )


def _leaves(parents: list[Species], stems: float, num_levels: int, rng: np.random.Generator) -> Foliage:
    if rng.random() < BARE_SHARE:
        return Foliage(kind="none")
    own = _one_of([species for species in parents if species.foliage.kind != "none"], rng).foliage
    aspect = _between(LEAF_ASPECT, rng)
    more = (4.0 if num_levels == 2 else 1.0) / math.sqrt(aspect)  # long branches that bear leaves themselves
    return replace(
        own,
        kind=KINDS[int(rng.integers(len(KINDS)))],
        count=min(own.count * more * _factor(1.7, rng), MAX_LEAVES / stems),
        size=_between(LEAF_SIZE, rng),
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
    return _between((1 / largest, largest), rng)


def _between(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw between two values, uniform in the logarithm."""
    return math.exp(float(rng.uniform(math.log(bounds[0]), math.log(bounds[1]))))


def _one_of(species: list[Species], rng: np.random.Generator) -> Species:
    return species[int(rng.integers(len(species)))]
