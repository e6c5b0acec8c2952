"""How many splats that name no axis stand upright after reading: tilted trees without ground, on ground, on a slope.

Points of the 14 generated species, each tilted about three random horizontal axes, and the splats of
DYNAMICTREE_SAMPLES and of `foreign` beside it. A splat is `upright` within 2° of +Z; `turned` is what is turned at all.

    python -m benchmarks level_splats
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks._machine import machine
from dynamictree.formats.cloud_file import read_cloud
from dynamictree.plant.level import up_of_standing
from dynamictree.plant.sample import surface_points
from dynamictree.up_axis import turn_to_z
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES

TILTS_DEG, AXES_A_TILT = (0, 12, 25, 40), 3
FILE_TILTS_DEG = (0, 5, 10, 25, 40)
FILES = ("data/splat/tree_10k.splat", "foreign/splat/houseplant.splat")
SLOPE_DEG, UPRIGHT_DEG, TARGET = 15.0, 2.0, 40 / 42
_VISIBLE = 0.1  # opacity
_GROUND_POINTS = 12_000
_ROUGH = 0.004  # of the height: standard deviation of the ground


@dataclass(frozen=True)
class Tally:
    """Of tilted scenes, and of those that stood upright before; what is `left_deg` of the tilt in each."""

    left_deg: dict[str, list[float]]
    turned: int
    upright: int
    scenes: int


def run() -> dict[str, object]:
    rng = np.random.default_rng(0)
    trees = {name: _tree(name) for name in SPECIES}
    alone = _tally(trees, TILTS_DEG, rng)
    ground = _tally({name: np.concatenate([t, _ground(t, 0, rng)]) for name, t in trees.items()}, TILTS_DEG[1:], rng)
    slope = _tally({name: np.concatenate([t, _ground(t, SLOPE_DEG, rng)]) for name, t in trees.items()}, (0,), rng)
    return {
        "value": round(ground.upright / ground.scenes, 3),
        "unit": f"share of trees on level ground within {UPRIGHT_DEG}° of upright",
        "target": round(TARGET, 3),
        "on_ground": vars(ground),
        "alone": {"turned": alone.turned, "scenes": alone.scenes},
        "on_slope": {"turned": slope.turned, "scenes": slope.scenes, "left_deg": slope.left_deg},
        "files": {name: _tally({name: points}, FILE_TILTS_DEG, rng).left_deg[name] for name, points in _files()},
        **machine("numpy", "scipy"),
    }


def _tally(scenes: dict[str, np.ndarray], tilts_deg: tuple[int, ...], rng: np.random.Generator) -> Tally:
    left: dict[str, list[float]] = {}
    turned = 0
    for name, points in scenes.items():
        for tilt_deg in np.repeat(tilts_deg, AXES_A_TILT):
            azimuth = rng.uniform(0, 2 * np.pi)
            tilt = Rotation.from_rotvec(np.radians(tilt_deg) * np.array([np.cos(azimuth), np.sin(azimuth), 0]))
            level = up_of_standing(tilt.apply(points))
            turned += level is not None
            up = (np.eye(3) if level is None else turn_to_z(level)) @ tilt.apply([0, 0, 1])
            left.setdefault(name, []).append(round(float(np.degrees(np.arccos(min(up[2], 1)))), 1))
    every = np.concatenate(list(left.values()))
    return Tally(left_deg=left, turned=turned, upright=int((every <= UPRIGHT_DEG).sum()), scenes=len(every))


def _tree(species: str) -> np.ndarray:
    sampled = surface_points(grow_tree(SPECIES[species], np.random.default_rng(4)).mesh, 20_000)
    assert sampled is not None
    points = sampled[0]
    return points - [0, 0, points[:, 2].min()]


def _ground(tree: np.ndarray, slope_deg: float, rng: np.random.Generator) -> np.ndarray:
    """A rough disc as wide as two trees are high, through the foot."""
    height = float(np.ptp(tree[:, 2]))
    away, turn = height * np.sqrt(rng.random(_GROUND_POINTS)), rng.uniform(0, 2 * np.pi, _GROUND_POINTS)
    disc = np.stack([away * np.cos(turn), away * np.sin(turn), _ROUGH * height * rng.normal(size=len(away))], axis=1)
    azimuth = rng.uniform(0, 2 * np.pi)
    return Rotation.from_rotvec(np.radians(slope_deg) * np.array([np.cos(azimuth), np.sin(azimuth), 0])).apply(disc)


def _files() -> Iterator[tuple[str, np.ndarray]]:
    """Of the files that are there, whose own axes are level."""
    samples = os.environ.get("DYNAMICTREE_SAMPLES")
    for path in [Path(samples).parent / name for name in FILES] if samples else []:
        if path.exists():
            with path.open("rb") as stream:
                cloud = read_cloud(stream, file_type=path.suffix[1:], up_axis=None, unit_m=None)
            yield path.name, cloud.means[cloud.opacity >= _VISIBLE].astype(np.float64)
