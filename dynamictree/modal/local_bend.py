"""Local bends over time: joints between a dragged point and the root follow the drag, and swing when it ends.

All joints of one place swing together, as one oscillator whose frequency is that at which the modes ring there:

    κ̈ + 2 ζ ω κ̇ + ω² κ = ω² κ*(t),        ω² = Σ_k ω_k² |q_k|² / Σ_k |q_k|²   (Rayleigh's quotient)

with κ* the solution of `pull.py` while the pull acts, and q the answer of the modes to a force there.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from dynamictree.modal.force import Contact, compliance, generalised
from dynamictree.modal.step import State, Step, exact_oscillator, run
from dynamictree.modal.system import ModalSystem


@dataclass(frozen=True, kw_only=True)
class Bend:
    """State of the joints under one place, from the grip's own bone towards the root."""

    turn: Float64[np.ndarray, "n 3"]  # κ [rad]
    rate: Float64[np.ndarray, "n 3"]  # [rad/s]

    @classmethod
    def straight(cls, num_bones: int = 0) -> "Bend":
        """No bend."""
        return cls(turn=np.zeros((num_bones, 3)), rate=np.zeros((num_bones, 3)))


def own_omega(system: ModalSystem, at: Contact) -> float:
    """Frequency at which a place rings after a pull in its softest direction [rad/s]."""
    softest = np.linalg.eigh(compliance(system, at))[1][:, -1]
    share = np.abs(generalised(system, at, softest) / system.stiffness) ** 2
    total = float(share.sum())
    return float(np.sqrt((system.omega**2 * share).sum() / total)) if total > 0 else float(system.omega[0])


def swing(
    system: ModalSystem, at: Contact, begin: Bend, aims: Float64[np.ndarray, "T n 3"], *, dt_s: float
) -> tuple[Float64[np.ndarray, "T n 3"], Bend]:
    """Bends at times 0, dt, … and the state after the last step; `aims` is κ* of each step."""
    omega = np.array([own_omega(system, at)])
    zeta = np.array([float(system.damping_ratio.min())])
    step = exact_oscillator(omega, zeta, dt_s)
    state = State(q=begin.turn.reshape(-1, 1).astype(np.complex128), q_dot=begin.rate.reshape(-1, 1) + 0j)
    frames, final = run(step, state, omega**2 * aims.reshape(len(aims), -1, 1) + 0j)
    shape = begin.turn.shape
    turns = np.ascontiguousarray(frames.real).reshape(len(aims), *shape)
    last, rate = (np.ascontiguousarray(part.real).reshape(shape) for part in (final.q, final.q_dot))
    return turns, Bend(turn=last, rate=rate)


def ring(step: Step, bend: Bend) -> Bend:
    """One step of joints that nothing holds."""
    (a, b), (c, d) = step.A
    return Bend(turn=a * bend.turn + b * bend.rate, rate=c * bend.turn + d * bend.rate)
