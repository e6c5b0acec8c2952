"""Time steps of the oscillators: y⁺ = A y + B a, with y = (q, q̇) and the acceleration a constant over the step.

`exact_step` is the default. `symplectic_euler_step` and `explicit_euler_step` (Davis et al. 2015, equation 11, and the
paper's) are the usual cheap ones; they differ in A and B only.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np
from jaxtyping import Complex128, Float64

from dynamictree.errors import InputError, UnstableTimestep
from dynamictree.modal.system import ModalSystem
from dynamictree.requests import Integrator

INTEGRATORS: tuple[Integrator, ...] = get_args(Integrator)


@dataclass(frozen=True, kw_only=True)
class Step:
    """Matrices that advance (q, q̇) by dt."""

    A: Float64[np.ndarray, "2 2 M"]
    B: Float64[np.ndarray, "2 M"]
    dt_s: float


@dataclass(frozen=True, kw_only=True)
class State:
    """Modal coordinates and their rates, one row per group of forces."""

    q: Complex128[np.ndarray, "G M"]
    q_dot: Complex128[np.ndarray, "G M"]  # [1/s]

    @classmethod
    def at_rest(cls, num_groups: int, num_modes: int) -> "State":
        """Return the state of the undisturbed tree."""
        zero = np.zeros((num_groups, num_modes), np.complex128)
        return cls(q=zero, q_dot=zero)


def exact_step(system: ModalSystem, dt_s: float) -> Step:
    """Return the closed form of the damped oscillator under a constant force, exact for every dt and ζ."""
    return exact_oscillator(system.omega, system.damping_ratio, dt_s)


def exact_oscillator(omega: Float64[np.ndarray, " M"], zeta: Float64[np.ndarray, " M"], dt_s: float) -> Step:
    """Return the exact step of oscillators with these natural frequencies [rad/s] and damping ratios."""
    h = _positive(dt_s)
    angle = omega * h * np.sqrt(np.abs(1 - zeta**2))
    swings = zeta <= 1
    decay = np.exp(-zeta * omega * h)
    # If overdamped, cosine and sine become cosh and sinh. Their growth and the decay are one exponential, since each
    # alone overflows or underflows in long steps.
    slow = np.exp(np.where(swings, 0.0, angle - zeta * omega * h))
    C = np.where(swings, decay * np.cos(angle), slow * (1 + np.exp(-2 * angle)) / 2)
    # sin(ω_d h) / ω_d and sinh(ω_d h) / ω_d [s]; the limit at ω_d = 0 is h
    sinh = -np.expm1(-2 * angle) / np.where(angle > 0, 2 * angle, 1)
    S = h * np.where(swings, decay * np.sinc(angle / np.pi), slow * sinh)
    A = np.array([[C + zeta * omega * S, S], [-(omega**2) * S, C - zeta * omega * S]])
    B = np.array([(1 - A[0, 0]) / omega**2, S])
    return Step(A=A, B=B, dt_s=h)


def symplectic_euler_step(system: ModalSystem, dt_s: float) -> Step:
    """Update the rate first, then the coordinate with the new rate; first order.

    Raises:
        UnstableTimestep: ω dt > 2 (√(1 + ζ²) − ζ) for a mode.
    """
    omega, zeta, h = system.omega, system.damping_ratio, _positive(dt_s)
    longest = float((2 * (np.sqrt(1 + zeta**2) - zeta) / omega).min())
    _refuse_beyond(longest, h, "symplectic-euler")
    drag, spring, one = 1 - 2 * zeta * omega * h, -(omega**2) * h, np.ones_like(omega)
    return Step(A=np.array([[1 + h * spring, h * drag], [spring, drag]]), B=np.array([h * h * one, h * one]), dt_s=h)


def explicit_euler_step(system: ModalSystem, dt_s: float) -> Step:
    """Update both from the old state, as in the paper; first order. |eigenvalue|² = 1 − 2ζωh + ω²h² for ζ <= 1.

    Raises:
        UnstableTimestep: dt > 2ζ/ω for a mode; without damping no step is stable.
    """
    omega, zeta, h = system.omega, system.damping_ratio, _positive(dt_s)
    excess = np.sqrt(np.maximum(zeta**2 - 1, 0))
    longest = float((2 * np.minimum(zeta, 1 / (np.maximum(zeta, 1) + excess)) / omega).min())
    _refuse_beyond(longest, h, "explicit-euler")
    one = np.ones_like(omega)
    A = np.array([[one, h * one], [-(omega**2) * h, 1 - 2 * zeta * omega * h]])
    return Step(A=A, B=np.array([0 * one, h * one]), dt_s=h)


STEPS: dict[Integrator, Callable[[ModalSystem, float], Step]] = {
    "exact": exact_step,
    "symplectic-euler": symplectic_euler_step,
    "explicit-euler": explicit_euler_step,
}


def run(
    step: Step, state: State, acceleration: Complex128[np.ndarray, "T G M"]
) -> tuple[Complex128[np.ndarray, "T G M"], State]:
    """Compute coordinates at times 0, dt, … (T - 1) dt, and the state at T dt, the first frame of a next run.

    The acceleration is the generalised force over modal mass, constant over each step [1/s²].
    """
    (a, b), (c, d) = step.A
    kick, push = step.B
    q, q_dot = state.q, state.q_dot
    frames = np.empty(acceleration.shape, np.complex128)
    for n, constant in enumerate(acceleration):
        frames[n] = q
        q, q_dot = a * q + b * q_dot + kick * constant, c * q + d * q_dot + push * constant
    return frames, State(q=q, q_dot=q_dot)


def energy(system: ModalSystem, state: State) -> float:
    """Compute the kinetic and elastic energy of all groups, m Σ (|q̇|² + ω²|q|²) / 2 [J]."""
    density = np.abs(state.q_dot) ** 2 + system.omega**2 * np.abs(state.q) ** 2
    return float(system.modal_mass * density.sum() / 2)


def _positive(dt_s: float) -> float:
    if not (np.isfinite(dt_s) and dt_s > 0):
        raise InputError(f"dt_s is {dt_s}; it must be positive and finite")
    return float(dt_s)


def _refuse_beyond(longest: float, dt_s: float, name: str) -> None:
    if dt_s > longest:
        advice = f"take dt_s <= {longest:.6g}, " if longest > 0 else "without damping no step is stable: "
        raise UnstableTimestep(
            f"{name} diverges at dt_s = {dt_s:.6g}; {advice}or the exact integrator", max_dt_s=longest
        )
