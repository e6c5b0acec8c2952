"""Laws of one stem in air: its equation of motion, its drag, and what it bears."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynamictree.spectrum import FPS, NUM_FRAMES
from lab.dataset.oscillator import (
    CENTRE_OF_DRAG,
    MAX_LEAN_RAD,
    Load,
    Oscillators,
    bin_transfer,
    drag,
    growth_exponent,
    limit_angles,
    loads_of,
    oscillators,
    pressure,
)
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES

ROWS = ("points", "radii", "first", "parent", "parent_ring", "length_m")
TIMES = 8  # T in a loop: bins so narrow that their width does not matter


def stem(*, damping: float = 0.1, lean: float = 0.05) -> Oscillators:
    ones = np.ones(1)
    return Oscillators(omega=3.0 * ones, damping_ratio=damping * ones, lean=lean * ones, length_m=4.0 * ones)


def air_of(rng: np.random.Generator, size: float, num_frames: int) -> np.ndarray:
    """A slow breeze along +x, [3, 1, T]."""
    bins = np.arange(1, 20)
    phase = rng.uniform(0, 2 * np.pi, (3, len(bins), 1))
    waves = np.cos(2 * np.pi * bins[:, None] * np.arange(num_frames) / num_frames + phase).sum(axis=1)
    air = size * waves / np.sqrt(len(bins))
    air[0] += 5
    return air[:, None].astype(np.float32)


def test_the_answer_solves_the_equation_of_motion_with_drag_by_relative_speed(rng) -> None:
    """θ'' + 2 ζ ω θ' + ω² θ = ω² θ_w(u - ∂(base)/∂t - arm θ') - base'' / L, integrated until it repeats."""
    one, num_frames = stem(), TIMES * NUM_FRAMES
    air = air_of(rng, 1.0, num_frames)
    base = 0.05 * air_of(rng, 1.0, num_frames)
    answer = one.respond(air, base)[0, 0]
    period_s = num_frames / FPS
    hat = [np.fft.rfft(series[:, 0])[:, :20] / num_frames for series in (air, base)]  # all that they have
    omega = 2 * np.pi * np.arange(hat[0].shape[1]) / period_s

    def at(spectrum: np.ndarray, time: float) -> np.ndarray:
        wave = np.exp(1j * omega * time) * np.where(omega > 0, 2, 1)
        return (spectrum * wave).real.sum(axis=1)

    def slope(time: float, state: np.ndarray) -> np.ndarray:
        angle, rate = state[:3], state[3:]
        passing = at(hat[0], time) - at(1j * omega * hat[1], time) - CENTRE_OF_DRAG * one.length_m * rate
        target = one.static_angle(passing[:, None, None])[:, 0, 0]
        push = one.omega**2 * target - at(-(omega**2) * hat[1], time) / one.length_m
        return np.concatenate([rate, push - 2 * one.damping_ratio * one.omega * rate - one.omega**2 * angle])

    times = period_s + np.arange(0, num_frames, 8) / FPS
    solved = solve_ivp(slope, (0, times[-1]), np.zeros(6), t_eval=times, rtol=1e-6, atol=1e-8).y[0]
    assert np.sqrt(np.mean((solved - answer[::8]) ** 2)) < 0.03 * np.std(answer)


def test_the_transfer_of_a_bin_is_the_mean_over_its_width() -> None:
    omega = 2 * np.pi * np.arange(40) * FPS / NUM_FRAMES
    own, damping = np.array([4.5 * omega[1], 5.0 * omega[1]]), np.array([0.03, 0.03])
    transfer = bin_transfer(omega, own, damping)
    fine = np.arange(0.5, 39.5, 1e-3)[:, None] * omega[1] / own
    power = 1 / ((1 - fine**2) ** 2 + (2 * damping * fine) ** 2)
    np.testing.assert_allclose((np.abs(transfer[:, 1:]) ** 2).sum(axis=1), power.sum(axis=0) * 1e-3, rtol=0.15)
    on_bin, between = np.abs(transfer).max(axis=1)
    assert 0.5 < on_bin / between < 2


def test_drag_grows_as_the_square_in_light_air_and_less_in_a_storm() -> None:
    assert pressure(np.array([5.0])) == pytest.approx(1)
    for speed, least, most in ((0.5, 1.9, 2.0), (5.0, 1.5, 1.8), (25.0, 1.38, 1.45)):
        near = np.array([speed, 1.001 * speed])
        exponent = float(np.diff(np.log(pressure(near)))[0] / np.log(1.001))
        assert least < exponent < most
        assert growth_exponent(near[:1])[0] == pytest.approx(exponent, abs=1e-3)


def test_drag_points_where_the_air_goes_and_a_stem_never_bends_past_its_bound(rng) -> None:
    passing = rng.normal(0, 10, (3, 5, 7))
    force = drag(passing)
    np.testing.assert_allclose(np.cross(passing, force, axis=0), 0, atol=1e-9)
    assert (np.sqrt((limit_angles(100 * force) ** 2).sum(axis=0)) <= MAX_LEAN_RAD * (1 + 1e-9)).all()
    np.testing.assert_allclose(limit_angles(1e-3 * force), 1e-3 * force, rtol=1e-2)


def test_loads_gather_towards_the_root() -> None:
    tree = grow_tree(SPECIES["round-broadleaf"], np.random.default_rng(0))
    loads = loads_of(tree.stems, tree.leaves, bare=False)
    assert (loads[0].foliage == 1).all()
    assert loads[0].branches.max() > 0.2
    assert (loads[-1].branches < 1e-6).all()  # twigs bear leaves alone
    assert loads[-1].foliage.mean() > 0.5
    assert all((load.foliage == 0).all() for load in loads_of(tree.stems, (), bare=True))
    assert all((load.foliage == 1).all() for load in loads_of(tree.stems, (), bare=False))


def test_a_lopsided_load_has_an_offset_and_damping_grows_with_the_load() -> None:
    tree = grow_tree(SPECIES["maple"], np.random.default_rng(0))
    trunk, branches = tree.stems[:2]
    rows = {name: getattr(branches, name)[:1] for name in ROWS}
    one_side = replace(branches, **rows)
    along = np.cross(loads_of((trunk, one_side), (), bare=True)[0].offset[0], [0, 0, 1])
    assert np.linalg.norm(along) > 1e-4
    light, heavy = (
        Load(foliage=np.float32([share]), branches=np.float32([share]), offset=np.zeros((1, 3), np.float32))
        for share in (0.0, 1.0)
    )
    ratios = [oscillators(np.float32([2]), np.float32([0.03]), load).damping_ratio[0] for load in (light, heavy)]
    assert ratios[0] < 0.04 < 0.1 < ratios[1]
