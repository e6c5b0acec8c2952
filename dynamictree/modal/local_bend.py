"""Dynamics of local bends: joints between a dragged point and the root follow the drag, and swing when it ends.

Each joint is an oscillator, whose frequency is the mean of the modes' frequencies weighted by their motion beyond it:

    κ̈ + 2 ζ ω κ̇ + ω² κ = ω² κ*(t),        ω² = Σ_k ω_k² e_k / Σ_k e_k

with κ* the solution of `pull.py` while the pull acts, and e_k the squared motion in mode k of the voxels beyond the
joint relative to it. So twigs swing faster than the trunk.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from dynamictree.modal.step import State, Step, exact_oscillator, run
from dynamictree.modal.system import ModalSystem


@dataclass(frozen=True, kw_only=True)
class Bend:
    """State of the joints of one grip, from the grip's own joint towards the root."""

    turn: Float64[np.ndarray, "n 3"]  # κ [rad]
    rate: Float64[np.ndarray, "n 3"]  # [rad/s]

    @classmethod
    def straight(cls, num_bones: int = 0) -> "Bend":
        """Return the state without bends."""
        return cls(turn=np.zeros((num_bones, 3)), rate=np.zeros((num_bones, 3)))


def joints_step(system: ModalSystem, omega: Float64[np.ndarray, " n"], dt_s: float) -> Step:
    """Create the time step of joints with these frequencies [rad/s]."""
    return exact_oscillator(omega, np.full(len(omega), system.damping_ratio.min()), dt_s)


def drive(step: Step, begin: Bend, pull: Float64[np.ndarray, "T n 3"]) -> tuple[Float64[np.ndarray, "T n 3"], Bend]:
    """Compute driven bends at times 0, dt, … and the state after the last step; `pull` is κ* of each step."""
    state = State(q=begin.turn.T.astype(np.complex128), q_dot=begin.rate.T + 0j)
    stiffness = (1 - step.A[0, 0]) / step.B[0]  # ω²
    frames, final = run(step, state, stiffness * pull.transpose(0, 2, 1) + 0j)
    turns = np.ascontiguousarray(frames.real.transpose(0, 2, 1))
    last, rate = (np.ascontiguousarray(part.real.T) for part in (final.q, final.q_dot))
    return turns, Bend(turn=last, rate=rate)


def free_step(step: Step, bend: Bend) -> Bend:
    """Advance released joints by one step."""
    (a, b), (c, d) = step.A[..., None]
    return Bend(turn=a * bend.turn + b * bend.rate, rate=c * bend.turn + d * bend.rate)
