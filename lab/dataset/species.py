"""Species parameters after Weber and Penn (SIGGRAPH 1995), and our presets."""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

Shape = Literal[
    "conical", "spherical", "hemispherical", "cylindrical", "tapered-cylindrical", "flame", "inverse-conical",
    "tend-flame", "shallow-cone",
]  # fmt: skip
SHAPES: tuple[Shape, ...] = get_args(Shape)
LeafKind = Literal["none", "leaf", "cluster", "needle", "frond", "clump"]

KEY_SPREAD = 0.25  # key parameters except height: uniform within this share of the preset's value
REST_SPREAD = 0.05  # all other parameters: normal with this relative deviation


@dataclass(frozen=True, kw_only=True)
class Level:
    """One level of branching: the trunk is level 0. Angles in degrees; a name ending in _var is a spread."""

    length: float  # share of the parent's length (level 0: of the tree's height)
    length_var: float = 0.1
    count: float = 1.0  # number of stems on a parent of full length (level 0: trunks)
    segments: int = 6  # Weber and Penn's curveRes
    sides: int = 5  # sides of the tube
    curve: float = 0.0  # total bend from base to tip; positive is down
    curve_back: float | None = None  # bend of the upper half, if different
    curve_var: float = 20.0
    down: float = 60.0  # angle from the parent's axis
    down_var: float = 10.0  # if negative: from down - var at the parent's base to down + var at its tip
    rotate: float = 137.5  # angle about the parent from one stem to the next
    rotate_var: float = 15.0
    splits: float = 0.0  # Weber and Penn's segSplits, per segment
    split_angle: float = 30.0
    tropism: float = 0.0  # Weber and Penn's attractUp
    taper: float = 0.95  # share of the radius lost from base to tip


@dataclass(frozen=True, kw_only=True)
class Foliage:
    """Leaves, as cards, on the last level and fewer on the one above; or one closed clump per stem."""

    kind: LeafKind = "leaf"
    count: float = 8.0  # number on a stem of full length; ignored for clumps
    size: float = 0.035  # length of a card or radius of a clump [share of the tree's height]
    aspect: float = 0.6  # width over length
    down: float = 50.0  # angle from the stem [deg]
    droop: float = 0.2  # bend towards the ground, 0 to 1
    color: tuple[float, float, float] = (0.18, 0.33, 0.08)  # linear RGB


@dataclass(frozen=True, kw_only=True)
class Species:
    """The parameters of one species."""

    name: str
    height_m: tuple[float, float]  # uniform range
    levels: tuple[Level, ...]
    shape: Shape = "spherical"
    base_size: float = 0.25  # bare share of the trunk's length
    ratio: float = 0.018  # trunk radius over length
    ratio_power: float = 1.2
    flare: float = 0.5  # widening of the trunk at the ground
    base_splits: float = 0.0  # forks of the trunk at the end of its bare part
    foliage: Foliage = Foliage()
    bark: tuple[float, float, float] = (0.16, 0.11, 0.07)  # linear RGB
    held_out: bool = False  # excluded from training, for evaluation

    def perturbed(self, rng: np.random.Generator) -> "Species":
        """Draw one tree's parameters: key ones vary widely, the rest slightly. Paper appendix A, step 1."""

        def key(value: float) -> float:
            return float(value * rng.uniform(1 - KEY_SPREAD, 1 + KEY_SPREAD))

        def rest(value: float) -> float:
            return float(value * np.clip(rng.normal(1, REST_SPREAD), 1 - 3 * REST_SPREAD, 1 + 3 * REST_SPREAD))

        levels = tuple(
            replace(
                level,
                length=rest(level.length) if depth else level.length,
                count=key(level.count),
                curve=rest(level.curve),
                curve_back=None if level.curve_back is None else rest(level.curve_back),
                down=rest(level.down) + rng.uniform(-6, 6) * (depth > 0),
                splits=rest(level.splits),
                split_angle=rest(level.split_angle),
                tropism=rest(level.tropism),
            )
            for depth, level in enumerate(self.levels)
        )
        foliage = replace(self.foliage, count=key(self.foliage.count), size=rest(self.foliage.size))
        height = float(rng.uniform(*self.height_m))
        return replace(
            self,
            height_m=(height, height),
            levels=levels,
            base_size=rest(self.base_size),
            ratio=key(self.ratio),
            foliage=foliage,
        )


_TRUNK = Level(length=1.0, segments=10, sides=8, curve_var=25.0, taper=0.9)
_PRESETS = (
    Species(
        name="round-broadleaf",
        height_m=(6.0, 12.0),
        shape="spherical",
        base_size=0.2,
        ratio=0.02,
        levels=(
            _TRUNK,
            Level(length=0.42, count=24.0, segments=7, sides=6, curve=-30.0, curve_var=50.0, down=62.0, down_var=-20.0),
            Level(length=0.42, count=9.0, segments=4, sides=4, curve=-20.0, curve_var=50.0, down=48.0),
        ),
        foliage=Foliage(kind="cluster", count=3.6, size=0.045, aspect=0.7),
    ),
    Species(
        name="spreading-broadleaf",
        height_m=(5.0, 11.0),
        shape="hemispherical",
        base_size=0.22,
        ratio=0.028,
        base_splits=2.0,
        levels=(
            replace(_TRUNK, segments=9, splits=0.08, split_angle=32.0, curve_var=50.0),
            Level(length=0.5, count=20.0, segments=8, sides=6, curve=-25.0, curve_var=70.0, down=70.0, splits=0.06),
            Level(length=0.4, count=9.0, segments=4, sides=4, curve=-10.0, curve_var=60.0, down=50.0),
        ),
        foliage=Foliage(kind="cluster", count=2.6, size=0.04, aspect=0.75, color=(0.15, 0.28, 0.07)),
    ),
    Species(
        name="maple",
        height_m=(5.0, 10.0),
        shape="tend-flame",
        base_size=0.18,
        ratio=0.02,
        base_splits=1.0,
        levels=(
            replace(_TRUNK, splits=0.05, split_angle=24.0),
            Level(length=0.45, count=22.0, segments=7, sides=6, curve=-45.0, curve_var=50.0, down=55.0, tropism=0.4),
            Level(length=0.45, count=9.0, segments=4, sides=4, curve=-20.0, curve_var=60.0, down=50.0, tropism=0.2),
        ),
        foliage=Foliage(kind="leaf", count=5.0, size=0.036, aspect=0.75, color=(0.36, 0.2, 0.05)),
    ),
    Species(
        name="weeping",
        height_m=(6.0, 11.0),
        shape="hemispherical",
        base_size=0.25,
        ratio=0.024,
        base_splits=1.5,
        held_out=True,
        levels=(
            replace(_TRUNK, segments=8, splits=0.08, split_angle=26.0, curve_var=50.0),
            Level(length=0.42, count=18.0, segments=8, sides=5, curve=20.0, curve_back=70.0, curve_var=50.0, down=50.0),
            Level(length=0.8, count=12.0, segments=7, sides=3, curve=20.0, curve_var=20.0, down=55.0, tropism=-2.6),
        ),
        foliage=Foliage(kind="leaf", count=7.0, size=0.032, aspect=0.3, down=30.0, droop=0.8),
    ),
    Species(
        name="columnar",
        height_m=(7.0, 14.0),
        shape="tapered-cylindrical",
        base_size=0.06,
        ratio=0.016,
        levels=(
            replace(_TRUNK, segments=12, curve_var=10.0),
            Level(length=0.26, count=46.0, segments=5, sides=4, curve=-20.0, curve_var=20.0, down=30.0, tropism=1.2),
            Level(length=0.3, count=6.0, segments=3, sides=3, curve=0.0, curve_var=30.0, down=35.0, tropism=0.6),
        ),
        foliage=Foliage(kind="cluster", count=3.0, size=0.026, aspect=0.6, color=(0.13, 0.27, 0.07)),
    ),
    Species(
        name="conical-conifer",
        height_m=(7.0, 15.0),
        shape="conical",
        base_size=0.11,
        ratio=0.014,
        levels=(
            replace(_TRUNK, segments=12, curve_var=6.0, taper=1.0),
            Level(length=0.32, count=60.0, segments=5, sides=4, curve=-25.0, curve_var=15.0, down=95.0, down_var=-20.0),
            Level(length=0.3, count=8.0, segments=2, sides=3, curve=-10.0, curve_var=20.0, down=55.0, rotate=180.0),
        ),
        foliage=Foliage(kind="needle", count=3.2, size=0.034, aspect=0.4, droop=0.35, color=(0.05, 0.16, 0.06)),
    ),
    Species(
        name="spire-conifer",
        height_m=(8.0, 15.0),
        shape="conical",
        base_size=0.1,
        ratio=0.013,
        levels=(
            replace(_TRUNK, segments=12, curve_var=6.0, taper=1.0),
            Level(
                length=0.17,
                count=75.0,
                segments=4,
                sides=4,
                curve=40.0,
                curve_back=-30.0,
                curve_var=12.0,
                down=105.0,
            ),
            Level(length=0.35, count=6.0, segments=2, sides=3, curve=20.0, curve_var=20.0, down=60.0, rotate=180.0),
        ),
        foliage=Foliage(kind="needle", count=3.5, size=0.03, aspect=0.45, droop=0.5, color=(0.05, 0.14, 0.08)),
    ),
    Species(
        name="pine",
        height_m=(6.0, 13.0),
        shape="inverse-conical",
        base_size=0.42,
        ratio=0.017,
        held_out=True,
        levels=(
            replace(_TRUNK, segments=11, curve_var=40.0, splits=0.03, split_angle=25.0),
            Level(length=0.34, count=28.0, segments=6, sides=5, curve=-40.0, curve_var=60.0, down=85.0, down_var=-15.0),
            Level(length=0.38, count=8.0, segments=3, sides=3, curve=-40.0, curve_var=40.0, down=55.0, tropism=0.6),
        ),
        foliage=Foliage(kind="needle", count=4.5, size=0.034, aspect=0.7, down=40.0, color=(0.07, 0.19, 0.08)),
    ),
    Species(
        name="palm",
        height_m=(4.0, 10.0),
        shape="cylindrical",
        base_size=0.96,
        ratio=0.022,
        flare=0.3,
        held_out=True,
        levels=(
            replace(_TRUNK, segments=14, curve=-12.0, curve_var=35.0, taper=0.3),
            Level(length=0.36, count=22.0, segments=9, sides=4, curve=75.0, curve_var=15.0, down=65.0, down_var=45.0),
        ),
        foliage=Foliage(kind="frond", count=30.0, size=0.075, aspect=0.12, down=60.0, droop=0.5),
    ),
    Species(
        name="shrub",
        height_m=(1.5, 3.5),
        shape="spherical",
        base_size=0.1,
        ratio=0.014,
        flare=0.1,
        levels=(
            Level(length=0.95, count=7.0, segments=7, sides=5, curve=25.0, curve_var=50.0, down=28.0, length_var=0.2),
            Level(length=0.42, count=24.0, segments=5, sides=4, curve=-20.0, curve_var=60.0, down=50.0, tropism=0.4),
            Level(length=0.45, count=5.0, segments=3, sides=3, curve=0.0, curve_var=50.0, down=50.0),
        ),
        foliage=Foliage(kind="leaf", count=5.0, size=0.042, aspect=0.5),
    ),
    Species(
        name="sapling",
        height_m=(1.0, 2.2),
        shape="tend-flame",
        base_size=0.25,
        ratio=0.011,
        flare=0.15,
        levels=(
            replace(_TRUNK, segments=12, sides=6, curve_var=45.0),
            Level(length=0.38, count=20.0, segments=6, sides=4, curve=-30.0, curve_var=50.0, down=50.0, tropism=0.5),
            Level(length=0.35, count=5.0, segments=3, sides=3, curve=0.0, curve_var=50.0, down=50.0),
        ),
        foliage=Foliage(kind="leaf", count=7.0, size=0.05, aspect=0.5, droop=0.4, color=(0.24, 0.4, 0.1)),
    ),
    Species(
        name="bare-winter",
        height_m=(5.0, 12.0),
        shape="spherical",
        base_size=0.22,
        ratio=0.022,
        base_splits=1.0,
        levels=(
            replace(_TRUNK, splits=0.06, split_angle=26.0, curve_var=45.0),
            Level(length=0.45, count=20.0, segments=7, sides=5, curve=-35.0, curve_var=60.0, down=58.0, tropism=0.3),
            Level(length=0.42, count=8.0, segments=4, sides=4, curve=-30.0, curve_var=70.0, down=48.0, tropism=0.2),
            Level(length=0.42, count=4.0, segments=2, sides=3, curve=0.0, curve_var=50.0, down=42.0),
        ),
        foliage=Foliage(kind="none"),
    ),
    Species(
        name="birch",
        height_m=(7.0, 14.0),
        shape="tapered-cylindrical",
        base_size=0.2,
        ratio=0.012,
        bark=(0.62, 0.6, 0.56),
        levels=(
            replace(_TRUNK, segments=12, curve_var=25.0),
            Level(length=0.3, count=34.0, segments=6, sides=5, curve=10.0, curve_back=50.0, curve_var=40.0, down=48.0),
            Level(length=0.5, count=8.0, segments=4, sides=3, curve=40.0, curve_var=40.0, down=45.0, tropism=-0.6),
        ),
        foliage=Foliage(kind="leaf", count=6.0, size=0.028, aspect=0.6, droop=0.5, color=(0.28, 0.38, 0.08)),
    ),
    Species(
        name="acacia",
        height_m=(4.0, 9.0),
        shape="inverse-conical",
        base_size=0.52,
        ratio=0.026,
        base_splits=2.5,
        levels=(
            replace(_TRUNK, segments=8, splits=0.06, split_angle=42.0, curve_var=30.0),
            Level(length=0.5, count=16.0, segments=7, sides=5, curve=25.0, curve_back=50.0, curve_var=30.0, down=58.0),
            Level(length=0.45, count=10.0, segments=4, sides=4, curve=0.0, curve_var=50.0, down=60.0, rotate=180.0),
        ),
        foliage=Foliage(kind="cluster", count=3.0, size=0.036, aspect=0.8, down=70.0, droop=0.05),
    ),
)

SPECIES: dict[str, Species] = {species.name: species for species in _PRESETS}
