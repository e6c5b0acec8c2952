"""The rival is honest: it falls as a stone does, keeps its momentum, and swings as an elastic rod does."""

import numpy as np
import pytest

from benchmarks import _mpm as mpm

GRAVITY = -9.81


def cloud(rng, count=3000):
    return rng.uniform(-1, 1, (count, 3)) * [0.2, 0.2, 0.3]


def test_a_free_fall_is_the_analytic_one(rng):
    particles = mpm.particles_at(cloud(rng), filled=0.3)
    begin = particles.position.copy()
    mpm.advance(particles, num_substeps=100, gravity=GRAVITY)
    seconds = 100 * mpm.DT_S
    fallen = particles.position - begin
    # the method's own sum: speed is updated before place
    np.testing.assert_allclose(fallen[:, 2], GRAVITY * seconds * (seconds + mpm.DT_S) / 2, rtol=2e-3)
    np.testing.assert_allclose(particles.velocity[:, 2], GRAVITY * seconds, rtol=2e-3)
    assert np.abs(fallen[:, :2]).max() < 1e-5


def test_momentum_and_angular_momentum_stay_without_forces(rng):
    particles = mpm.particles_at(cloud(rng), filled=0.3)
    centre = particles.position.mean(axis=0)
    particles.velocity[:] = np.cross([0.0, 0.0, 3.0], particles.position - centre) + np.array([0.1, 0, 0])

    def angular():
        return np.cross(particles.position - particles.position.mean(axis=0), particles.velocity)[:, 2].mean()

    mpm.advance(particles, num_substeps=1)
    before, spin = particles.velocity.mean(axis=0), angular()
    mpm.advance(particles, num_substeps=100)
    np.testing.assert_allclose(particles.velocity.mean(axis=0), before, atol=2e-4)
    assert angular() == pytest.approx(spin, rel=0.05)
