"""What the answer to a force must obey."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.modal.force import (
    Contact,
    Drag,
    Impulse,
    WindField,
    compliance,
    contact_at_point,
    davis_state,
    drag_force_n,
    equilibrium,
    generalised_force,
)
from dynamictree.modal.step import State, exact_step, run
from dynamictree.modal.system import displacement, modal_system

DT_S = 1 / 60
TIP = Contact(rows=np.array([39], np.int32), weights=np.ones(1))
MIDDLE = Contact(rows=np.array([20], np.int32), weights=np.ones(1))


def answer(system, *forces, num_frames=90, dt_s=DT_S, begin=None):
    """Displacement of every voxel at every frame [m]."""
    total = sum(generalised_force(system, force, dt_s=dt_s, num_frames=num_frames) for force in forces)
    begin = begin or State.at_rest(1, system.num_modes)
    frames, _ = run(exact_step(system, dt_s), begin, total[:, None] / system.modal_mass)
    return displacement(system.shapes, frames[:, 0])


KNOCK = Impulse(at=TIP, impulse_n_s=(3.0, -1.0, 0.5), start_s=0.1)
PULL = Drag(at=MIDDLE, force_n=(0.0, 4.0, 0.0), start_s=0.2, duration_s=0.5)


@pytest.mark.parametrize("kind", ["impulse", "force", "displacement"])
def test_the_answer_is_linear_in_the_force(system, rng, kind):
    def push(vector):
        vector = tuple(vector.tolist())
        if kind == "impulse":
            return Impulse(at=TIP, impulse_n_s=vector, duration_s=0.13)
        if kind == "force":
            return Drag(at=TIP, force_n=vector, duration_s=0.4)
        return Drag(at=TIP, displacement_m=vector, duration_s=0.4)

    a, b = rng.normal(size=(2, 3))
    mixed = answer(system, push(2 * a - 3 * b))
    expected = 2 * answer(system, push(a)) - 3 * answer(system, push(b))
    np.testing.assert_allclose(mixed, expected, atol=1e-5 * np.abs(expected).max())


def test_the_answer_does_not_depend_on_the_strength_of_the_wind_that_made_the_modes(spectrum):
    stronger = replace(spectrum, coefficients=spectrum.coefficients * np.float32(3))
    np.testing.assert_allclose(
        answer(modal_system(stronger), KNOCK), answer(modal_system(spectrum), KNOCK), rtol=1e-3, atol=1e-6
    )


def test_a_single_mode_has_the_modal_mass_of_the_textbook(spectrum):
    system = modal_system(replace(spectrum, coefficients=spectrum.coefficients[:, :2]), mass_kg=20.0)
    # kinetic energy of 20 kg, spread over voxels that sway as Re φ exp(iωt): its mean over a turn
    speed = np.abs(system.shapes[:, 0]) * system.omega[0]
    kinetic = (20.0 / 40) * (speed**2).sum() / 4
    assert system.modal_mass * system.omega[0] ** 2 / 2 == pytest.approx(kinetic, rel=1e-6)


@pytest.mark.parametrize("dt_s", [1 / 24, 1 / 60, 0.013])
@pytest.mark.parametrize("duration_s", [0.0, 0.002, 0.31])
def test_an_impulse_keeps_its_newton_seconds_whatever_the_step(system, dt_s, duration_s):
    knock = Impulse(at=TIP, impulse_n_s=(1.0, 2.0, 3.0), start_s=0.05, duration_s=duration_s)
    pushed = generalised_force(system, knock, dt_s=dt_s, num_frames=60).sum(axis=0) * dt_s
    expected = system.shapes[39].conj().astype(complex) @ [1.0, 2.0, 3.0]
    np.testing.assert_allclose(pushed, expected, rtol=1e-9)


def test_a_drag_is_the_same_on_finer_steps(system):
    coarse = answer(system, PULL, num_frames=90)
    fine = answer(system, PULL, num_frames=360, dt_s=DT_S / 4)[::4]
    np.testing.assert_allclose(fine, coarse, atol=1e-6)


def test_a_constant_force_settles_in_its_equilibrium(spectrum):
    system = modal_system(spectrum, damping_ratio=0.9)
    load = Drag(at=TIP, force_n=(5.0, 0.0, 0.0))
    constant = generalised_force(system, load, dt_s=0.1, num_frames=400)
    _, end = run(exact_step(system, 0.1), State.at_rest(1, 15), constant[:, None] / system.modal_mass)
    rest = equilibrium(system, constant[:1])
    np.testing.assert_allclose(end.q, rest.q, atol=1e-9)
    sunk = displacement(system.shapes, rest.q)[0, 39]
    np.testing.assert_allclose(sunk, compliance(system, TIP) @ [5.0, 0.0, 0.0], rtol=1e-4)


def test_a_point_fixed_at_a_displacement_rests_there_and_swings_when_released(system):
    hold = Drag(at=TIP, displacement_m=(0.5, -0.3, 0.0), duration_s=0.5)
    constant = generalised_force(system, hold, dt_s=DT_S, num_frames=120)
    moved = answer(system, hold, num_frames=120, begin=equilibrium(system, constant[:1]))[:, 39]
    softest = np.linalg.eigh(compliance(system, TIP))[1][:, 2]
    np.testing.assert_allclose(moved[:30] @ softest, np.full(30, [0.5, -0.3, 0.0] @ softest), rtol=0.02)
    np.testing.assert_allclose(moved[:30], np.tile(moved[0], (30, 1)), atol=1e-6)
    assert (moved[31:, :2] @ [0.5, -0.3]).min() < -0.05


def test_a_stiff_direction_is_left_out_of_a_drag(spectrum):
    level = spectrum.coefficients * np.float32([1, 1, 0])  # nothing moves up or down
    system = modal_system(replace(spectrum, coefficients=level))
    upward = drag_force_n(system, Drag(at=TIP, displacement_m=(0.0, 0.0, 1.0)))
    np.testing.assert_allclose(upward, 0, atol=1e-9)


def test_the_state_of_davis_has_his_magnitude_and_phase(system):
    direction = np.array([0.6, 0.8, 0.0])
    moved = system.shapes[39] @ direction
    constant = davis_state(system, Drag(at=TIP, displacement_m=tuple(direction * 7)), gain=0.3)
    z = constant.q[0] - 1j * constant.q_dot[0] / system.omega
    np.testing.assert_allclose(np.abs(z) / np.abs(moved), 0.3 / np.abs(moved).max() ** 2, rtol=1e-5)
    np.testing.assert_allclose(np.angle(z * moved), 0, atol=1e-5)
    struck = davis_state(system, Impulse(at=TIP, impulse_n_s=tuple(direction)), gain=0.3)
    z = struck.q[0] - 1j * struck.q_dot[0] / system.omega
    np.testing.assert_allclose(np.angle(z * moved), -np.pi / 2, atol=1e-5)
    with pytest.raises(InputError, match="nothing moves"):
        davis_state(system, Impulse(at=TIP, impulse_n_s=(0.0, 0.0, 0.0)))


def test_wind_force_grows_with_the_square_of_the_speed(system):
    def pushed(speed):
        wind = WindField(velocity_m_s=np.array([[speed, 0.0, 0.0]]))
        return generalised_force(system, wind, dt_s=DT_S, num_frames=5)

    np.testing.assert_allclose(pushed(6.0), 4 * pushed(3.0), rtol=1e-12)
    np.testing.assert_allclose(pushed(-3.0), -pushed(3.0), rtol=1e-12)


def test_wind_follows_its_samples_over_time(system):
    wind = WindField(velocity_m_s=np.array([[0.0, 0, 0], [2.0, 0, 0], [0.0, 0, 0]]), start_s=0.5, duration_s=1.0)
    strength = np.abs(generalised_force(system, wind, dt_s=0.05, num_frames=40)).sum(axis=1)
    assert strength[:10].max() == 0
    assert strength[30:].max() == 0
    assert abs(int(np.argmax(strength)) - 20) <= 1


def test_a_radius_spreads_the_force_over_what_lies_within(spectrum):
    with pytest.raises(InputError, match="must be finite"):
        contact_at_point(spectrum.grid, (float("nan"), 0.0, 0.0))
    at = contact_at_point(spectrum.grid, (0.05, 0.05, 2.0), radius_m=0.31)
    height = spectrum.grid.centres_m[at.rows, 2]
    assert len(at.rows) == 6
    assert np.abs(height - 2.0).max() <= 0.31
    assert at.weights.sum() == pytest.approx(1)


@pytest.mark.parametrize(
    "force",
    [
        Impulse(at=TIP, impulse_n_s=(float("nan"), 0.0, 0.0)),
        Impulse(at=TIP, impulse_n_s=(1.0, 0.0, 0.0), start_s=float("inf")),
        Drag(at=TIP, force_n=(float("inf"), 0.0, 0.0)),
        Drag(at=TIP, force_n=(1.0, 0.0, 0.0), duration_s=-1.0),
        Drag(at=TIP),
        Drag(at=TIP, force_n=(1.0, 0.0, 0.0), displacement_m=(1.0, 0.0, 0.0)),
        WindField(velocity_m_s=np.zeros((0, 3))),
        WindField(velocity_m_s=np.array([[np.nan, 0.0, 0.0]])),
    ],
)
def test_a_force_that_is_none_is_refused(system, force):
    with pytest.raises(InputError):
        generalised_force(system, force, dt_s=DT_S, num_frames=10)


def test_what_does_not_move_cannot_be_dragged(spectrum):
    coefficients = spectrum.coefficients.copy()
    coefficients[0] = 0
    root = Contact(rows=np.array([0], np.int32), weights=np.ones(1))
    with pytest.raises(InputError, match="does not move"):
        drag_force_n(
            modal_system(replace(spectrum, coefficients=coefficients)), Drag(at=root, displacement_m=(0.1, 0.0, 0.0))
        )
    with pytest.raises(InputError, match="does not move"):
        modal_system(replace(spectrum, coefficients=0 * coefficients))


@pytest.mark.parametrize(
    "options",
    [{"mass_kg": 0.0}, {"mass_kg": float("nan")}, {"damping_ratio": -0.1}, {"damping_ratio": np.full(3, 0.1)}],
)
def test_an_unphysical_system_is_refused(spectrum, options):
    with pytest.raises(InputError):
        modal_system(spectrum, **options)
