from dataclasses import replace

import numpy as np
import pytest

from lab.dataset.filter import edge_stretch, high_frequency_energy, measure, root_motion
from lab.dataset.limits import DatasetLimits
from lab.dataset.motion import Sway
from lab.dataset.sample import make_sample

FRAMES = np.arange(100)


def spoiled(sample, change):
    """The sample with the shift of its nodes changed."""
    shift = sample.motion.shift.copy()
    change(shift)
    return replace(sample, motion=Sway(shift=shift, turn=sample.motion.turn, position=sample.motion.position))


@pytest.mark.parametrize("name", ["palm", "shrub", "pine", "acacia"])
def test_the_generators_trees_pass_in_a_moderate_wind(name):
    sample = make_sample(1, name)
    sample = make_sample(1, name, wind=replace(sample.wind, speed_m_s=5.0))
    assert measure(sample).broken(DatasetLimits()) == ()


def test_shaking_twigs_are_rejected(sapling):
    def shake(shift):
        shift[:, -200:, 0] += 0.05 * sapling.mesh.height_m * np.cos(np.pi * FRAMES)[:, None]

    assert "high-frequency" in measure(spoiled(sapling, shake)).broken(DatasetLimits())


def test_a_moving_root_is_rejected(sapling):
    def slide(shift):
        shift[:, 0, 0] += 0.01 * sapling.mesh.height_m * np.sin(2 * np.pi * FRAMES / 100 + 1)

    assert measure(spoiled(sapling, slide)).broken(DatasetLimits())[0] == "root-motion"


def test_torn_tubes_are_rejected(sapling):
    def tear(shift):
        shift[:, 1::2] += 0.02 * sapling.mesh.height_m

    assert "edge-stretch" in measure(spoiled(sapling, tear)).broken(DatasetLimits())


def test_an_explosion_is_rejected(sapling):
    def explode(shift):
        shift[:, 1:] *= 40

    assert "self-explosion" in measure(spoiled(sapling, explode)).broken(DatasetLimits())


def test_what_is_not_finite_breaks_every_rule_that_sees_it(sapling):
    def burst(shift):
        shift[50, 1:] = np.nan

    with np.errstate(invalid="ignore"):
        broken = measure(spoiled(sapling, burst)).broken(DatasetLimits())
    assert {"high-frequency", "edge-stretch", "self-explosion"} <= set(broken)


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
