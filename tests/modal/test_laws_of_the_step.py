"""What an oscillator's step must obey, whatever the tree."""

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from dynamictree.errors import InputError, UnstableTimestep
from dynamictree.modal.step import State, energy, exact_step, explicit_euler_step, run, symplectic_euler_step
from dynamictree.modal.system import displacement, modal_system
from dynamictree.spectrum import iter_motion


def some_state(system, rng, num_groups=2):
    q, q_dot = rng.normal(size=(2, num_groups, system.num_modes, 2)).view(np.complex128)[..., 0]
    return State(q=q, q_dot=q_dot)


def some_force(system, rng, num_frames, num_groups=2):
    return rng.normal(size=(num_frames, num_groups, system.num_modes, 2)).view(np.complex128)[..., 0] * 5


def test_undriven_undamped_modes_replay_the_winds_loop_less_its_mean(spectrum):
    system = modal_system(spectrum, damping_ratio=0.0, frequency_hz=1 / spectrum.period_s)
    begin = State(q=np.ones((1, 15), complex), q_dot=1j * system.omega[None])
    dt_s = spectrum.period_s / 37  # no multiple of the frame time: the loop is replayed between frames too
    frames, end = run(exact_step(system, dt_s), begin, np.zeros((37, 1, 15), complex))
    sway = displacement(system.shapes, frames[:, 0])
    wind = np.stack(list(iter_motion(spectrum.coefficients, np.arange(37) / 37)))
    np.testing.assert_allclose(sway, wind - spectrum.coefficients[:, 0].real, atol=1e-6)
    np.testing.assert_allclose(end.q, begin.q, atol=1e-12)


@pytest.mark.parametrize("zeta", [0.0, 0.03, 0.999, 1.0, 1.5])
def test_exact_step_is_the_matrix_exponential(spectrum, zeta):
    system = modal_system(spectrum, damping_ratio=zeta)
    step = exact_step(system, 0.21)
    for k, omega in enumerate(system.omega):
        generator = np.array([[0, 1, 0], [-(omega**2), -2 * zeta * omega, 1], [0, 0, 0]])
        expected = scipy.linalg.expm(generator * 0.21)
        # ζ = 0.999 cancels half the digits of √(1 − ζ²) in the oracle's own eigenvalues
        np.testing.assert_allclose(step.A[:, :, k], expected[:2, :2], atol=1e-9)
        np.testing.assert_allclose(step.B[:, k], expected[:2, 2], atol=1e-9)


def test_symplectic_euler_moves_the_coordinate_by_the_new_rate(spectrum, rng):
    system = modal_system(spectrum, damping_ratio=0.1)
    begin = some_state(system, rng)
    _, end = run(symplectic_euler_step(system, 0.01), begin, some_force(system, rng, 1))
    np.testing.assert_allclose(end.q - begin.q, 0.01 * end.q_dot, atol=1e-12)


@pytest.mark.parametrize("zeta", [0.02, 1.3, np.linspace(0.01, 1.5, 15)])
def test_exact_step_agrees_with_scipys_integrator(spectrum, rng, zeta):
    system = modal_system(spectrum, damping_ratio=zeta)
    force = some_force(system, rng, 12, 1)
    begin = some_state(system, rng, 1)
    frames, end = run(exact_step(system, 0.1), begin, force)

    y = np.concatenate([begin.q[0], begin.q_dot[0]])
    for n in range(12):
        np.testing.assert_allclose(frames[n, 0], y[:15], atol=1e-6)

        def rate(_, y, a=force[n, 0]):
            q, v = y[:15], y[15:]
            return np.concatenate([v, a - 2 * zeta * system.omega * v - system.omega**2 * q])

        y = scipy.integrate.solve_ivp(rate, (0, 0.1), y, rtol=1e-10, atol=1e-10, method="DOP853").y[:, -1]
    np.testing.assert_allclose(end.q[0], y[:15], atol=1e-6)
    np.testing.assert_allclose(end.q_dot[0], y[15:], atol=1e-6)


@pytest.mark.parametrize("zeta", [0.0, 0.05, 1.0, 2.0])
def test_with_no_force_energy_never_grows(spectrum, rng, zeta):
    system = modal_system(spectrum, damping_ratio=zeta)
    state, step = some_state(system, rng), exact_step(system, 0.3)
    for _ in range(50):
        before = energy(system, state)
        _, state = run(step, state, np.zeros((1, 2, 15), complex))
        assert energy(system, state) <= before * (1 + 1e-12)
    if zeta == 0:
        assert energy(system, state) == pytest.approx(before, rel=1e-12)


@pytest.mark.parametrize("make_step", [symplectic_euler_step, explicit_euler_step])
def test_euler_steps_converge_with_order_one(spectrum, rng, make_step):
    system = modal_system(spectrum, damping_ratio=0.1)
    begin, force = some_state(system, rng), some_force(system, rng, 1)
    _, truth = run(exact_step(system, 0.2), begin, force)

    def error(num_steps):
        _, end = run(make_step(system, 0.2 / num_steps), begin, np.repeat(force, num_steps, axis=0))
        return np.abs(end.q - truth.q).max()

    order = np.log2(error(1000) / error(2000))
    assert order == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("make_step", [symplectic_euler_step, explicit_euler_step])
@pytest.mark.parametrize("zeta", [0.05, 1.0, 1.7])
def test_the_longest_step_is_the_border_of_stability(spectrum, make_step, zeta):
    system = modal_system(spectrum, damping_ratio=zeta)
    with pytest.raises(UnstableTimestep, match="diverges") as refusal:
        make_step(system, 10.0)
    longest = refusal.value.max_dt_s

    def radius(dt_s):
        A = make_step(system, dt_s).A
        return max(np.abs(np.linalg.eigvals(A[:, :, k])).max() for k in range(15))

    assert radius(longest) == pytest.approx(1, abs=1e-7)
    assert radius(longest * 0.99) < 1
    with pytest.raises(UnstableTimestep):
        make_step(system, longest * 1.001)


def test_undamped_explicit_euler_has_no_stable_step(spectrum):
    with pytest.raises(UnstableTimestep, match="no step is stable") as refusal:
        explicit_euler_step(modal_system(spectrum, damping_ratio=0.0), 1e-9)
    assert refusal.value.max_dt_s == 0


@pytest.mark.parametrize("dt_s", [0.0, -0.1, float("nan"), float("inf")])
def test_a_step_that_is_no_time_is_refused(system, dt_s):
    with pytest.raises(InputError, match="dt_s"):
        exact_step(system, dt_s)
