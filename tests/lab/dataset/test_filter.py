from dataclasses import replace

import numpy as np
import pytest

from dynamictree.spectrum import Wind
from lab.dataset.filter import edge_stretch, high_frequency_energy, measure, root_motion
from lab.dataset.limits import DatasetLimits
from lab.dataset.sample import make_sample

FRAMES = np.arange(100)


def shake(shift, height_m):
    shift[:, -200:, 0] += 0.05 * height_m * np.cos(np.pi * FRAMES)[:, None]


def slide(shift, height_m):
    shift[:, 0, 0] += 0.01 * height_m * np.sin(2 * np.pi * FRAMES / 100 + 1)


def tear(shift, height_m):
    shift[:, 1::2] += 0.02 * height_m


def explode(shift, height_m):
    shift[:, 1:] *= 40


def burst(shift, height_m):
    shift[50, 1:] = np.nan


@pytest.mark.parametrize("name", ["palm", "shrub", "pine", "acacia"])
def test_the_generators_trees_pass_in_a_moderate_wind(name):
    assert measure(make_sample(1, name, wind=Wind(speed_m_s=5.0))).violated(DatasetLimits()) == ()


@pytest.mark.parametrize(
    ("change", "rules"),
    [
        (shake, {"high-frequency"}),
        (slide, {"root-motion"}),
        (tear, {"edge-stretch"}),
        (explode, {"self-explosion"}),
        (burst, {"high-frequency", "edge-stretch", "self-explosion"}),
    ],
)
def test_a_spoiled_motion_is_rejected_by_every_rule_that_sees_it(sapling, change, rules):
    motion = replace(sapling.motion, shift=sapling.motion.shift.copy())
    change(motion.shift, sapling.mesh.height_m)
    with np.errstate(invalid="ignore"):
        assert rules <= set(measure(replace(sapling, motion=motion)).violated(DatasetLimits()))


def test_high_frequency_energy_is_the_share_above():
    slow, fast = np.sin(2 * np.pi * 2 * FRAMES / 100), np.sin(2 * np.pi * 30 * FRAMES / 100)
    motion = np.zeros((100, 1, 3), np.float32)
    motion[:, 0, 0] = 7 + 2 * slow + fast
    assert high_frequency_energy(motion, fps=24.0, above_hz=3.0) == pytest.approx(1 / 5, rel=1e-4)
    assert high_frequency_energy(motion, fps=24.0, above_hz=8.0) == pytest.approx(0, abs=1e-6)
    assert high_frequency_energy(0 * motion, fps=24.0, above_hz=3.0) == 0


def test_edge_stretch_is_zero_for_a_rigid_motion_and_the_factor_for_a_growth(rng):
    vertices = rng.normal(size=(30, 3)).astype(np.float32)
    faces = rng.permutation(30).reshape(10, 3).astype(np.int32)
    rigid = np.broadcast_to(rng.normal(size=(5, 1, 3)), (5, 30, 3)).astype(np.float32)
    assert edge_stretch(vertices, faces, rigid) < 1e-5
    assert edge_stretch(vertices, faces, 0.25 * vertices[None]) == pytest.approx(0.25, rel=1e-4)


def test_root_motion_looks_at_the_ground_only():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 2]], np.float32)
    displacement = np.zeros((2, 3, 3), np.float32)
    displacement[1, 2] = 1
    assert root_motion(vertices, displacement) == 0
    displacement[1, 1, 1] = 0.5
    assert root_motion(vertices, displacement) == 0.25
