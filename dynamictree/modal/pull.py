"""Solve for the bends of the joints that hold a drawn point where a drag wants it.

Unknown are κ_i of the joints (`joints.py`) from the pulled one towards the root. Of all that bring the point to its
target x*, the solution has the least energy:

    |x* − x(κ)|² / ε  +  Σ_i |κ_i|² (1 + ½ |κ_i|² / κ_max²) / g_i

with x the point that is drawn, which its own bones carry, g_i = |r_i| / carried_i, |r_i| the length to the next
joint and carried_i the number of voxels beyond. So a branch bends at its thin end more than at its thick one, as a
cantilever, and no joint folds. ε only matters for a target that cannot be reached, such as one along a stem.

    x = x_0 + Σ_i A_i s_i,        A_i = A_{i+1} exp[κ_i]×,        i counts from the tip, and A is 1 beyond the last

s_i leads from joint i to the next one, or to the point, times the share that is carried beyond. Levenberg-Marquardt;
since the point has three coordinates, each step solves a 3 × 3 system. `equilibrium` is also in JavaScript,
`web/motion/pin.js`.
"""

from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int64

from dynamictree.modal.force import CarriedPoint
from dynamictree.modal.joints import Joints, cross_matrix, exponential, product, turned
from dynamictree.parallel import compiled

TOLERANCE = 1e-8  # ε over the compliance at rest: a direction in which nothing gives way is not followed
ROUNDS = 120
SETTLED = 3e-4  # of the target: a step that changes the point by less is the last
STEP_RAD = 0.5  # that a joint turns in a round
SLACK = 0.03  # of the pull: a drag ends so far within the length of the branches
DRAWN = 0.7  # of how much longer a crooked branch is than straight: so far it can be drawn


@dataclass(frozen=True, kw_only=True)
class Pull:
    """A point at rest under a drag."""

    bend: Float64[np.ndarray, "n 3"]  # κ from the grip's own joint towards the root
    reached_m: Float64[np.ndarray, " 3"]
    beyond_m: float  # how much too short the chain is, drawn straight [m]


@dataclass(frozen=True, kw_only=True)
class Grip:
    """One place that can be pulled, prepared once for any target."""

    segments_m: Float64[np.ndarray, "n 3"]  # s
    give: Float64[np.ndarray, " n"]  # g
    tolerance: float  # ε


def grip_at(joints: Joints, chain: Int64[np.ndarray, " n"], point: CarriedPoint) -> Grip:
    """Prepare a point whose chain of joints may bend."""
    place, at = joints.place_m[chain], point.point_m.astype(np.float64)
    index = {joint: row for row, joint in enumerate(chain.tolist())}
    segments, carried = np.zeros((len(chain), 3)), np.zeros(len(chain))  # share of the point beyond each joint
    for own, weight in zip(
        joints.of_bone[point.bones].tolist(), point.weights.astype(np.float64).tolist(), strict=True
    ):
        while own > 0 and own not in index:
            own = int(joints.parent[own])
        if own > 0:
            segments[index[own]] += weight * (at - place[index[own]])
            carried[index[own] :] += weight
    if len(chain) > 1:
        segments[1:] += carried[:-1, None] * (place[:-1] - place[1:])
    ends = np.concatenate([at[None], place])[: len(chain)]
    give = joints.give[chain] * np.linalg.norm(ends - place, axis=1)
    return grip_of(segments, give)


def grip_of(segments_m: Float64[np.ndarray, "n 3"], give: Float64[np.ndarray, " n"]) -> Grip:
    """A chain whose segments are these at rest."""
    arms = np.cumsum(segments_m, axis=0)
    return Grip(segments_m=segments_m, give=give, tolerance=TOLERANCE * float(2 * give @ (arms**2).sum(axis=1)))


def pull_to(grip: Grip, target_m: Float64[np.ndarray, " 3"], *, near: Float64[np.ndarray, "n 3"] | None = None) -> Pull:
    """Bring the point as near to its target as it can go [m from rest]; `near` is the bend for a target close by."""
    still = np.zeros_like(grip.segments_m)
    if grip.tolerance <= 0:
        return Pull(bend=still, reached_m=np.zeros(3), beyond_m=0.0)
    within, beyond = _within_length(grip.segments_m, target_m)
    return replace(equilibrium(grip, within, still if near is None else near), beyond_m=beyond)


def equilibrium(grip: Grip, target_m: Float64[np.ndarray, " 3"], bend: Float64[np.ndarray, "n 3"]) -> Pull:
    """The bend of least energy that holds the point at a target within reach, from a first guess on."""
    sure_damping = 1e-2  # a small step under more is not the last
    accept, refuse = 0.25, 6.0  # factors of Levenberg's damping
    first_damping, least_damping, most_damping = 0.1, 1e-9, 1e8
    damping, now = first_damping, _Linear(grip, bend, target_m)
    settled = SETTLED * float(np.linalg.norm(target_m))
    for _ in range(ROUNDS):
        tried = _Linear(grip, now.bend + now.step(damping), target_m)
        if not tried.cost < now.cost:
            damping *= refuse
            if damping > most_damping:
                break
            continue
        moved = float(np.linalg.norm(tried.reached - now.reached))
        now, last = tried, damping
        damping = max(damping * accept, least_damping)
        if moved < settled and last < sure_damping:
            break
    return Pull(bend=now.bend, reached_m=now.reached, beyond_m=0.0)


def _within_length(
    segments: Float64[np.ndarray, "n 3"], target_m: Float64[np.ndarray, " 3"]
) -> tuple[Float64[np.ndarray, " 3"], float]:
    """The place nearest to a target that the chain reaches with some slack, and how far the target is beyond it [m].

    Towards a place at the whole length or beyond, bends grow without bounds, and a crook is never drawn straight. A
    straight chain that bends evenly until its chord has turned by φ is as short as sin φ / φ of its length. Nearer to
    the root than its longest segment leaves room for, no chain folds.
    """
    chord, sizes = segments.sum(axis=0), np.linalg.norm(segments, axis=1)
    arm = chord + target_m  # from the root to the target
    distance, straight = float(np.linalg.norm(arm)), float(np.linalg.norm(chord))
    length = straight + DRAWN * (float(sizes.sum()) - straight)
    turned = float(np.arctan2(np.linalg.norm(np.cross(chord, arm)), chord @ arm))  # φ
    slack = SLACK * float(np.linalg.norm(target_m))
    longest = max(length - slack, straight * float(np.sinc(turned / np.pi)))
    shortest = min(2 * float(sizes.max()) - float(sizes.sum()) + slack, straight)
    within = target_m + (np.clip(distance, shortest, longest) / max(distance, 1e-12) - 1) * arm
    return within, max(0.0, distance - length)


class _Linear:
    """The problem around one guess: value, Jacobian and weights of the energy."""

    def __init__(self, grip: Grip, bend: Float64[np.ndarray, "n 3"], target_m: Float64[np.ndarray, " 3"]) -> None:
        largest_bend = 0.5  # κ_max, of one joint [rad]
        self.bend, self.tolerance = bend, grip.tolerance
        self.reached, jacobian = _reach(grip.segments_m, bend)
        self.jacobian = jacobian.reshape(3, -1)
        self.gap = target_m - self.reached
        size = (bend**2).sum(axis=1)
        folded = size / largest_bend**2
        self.soft = np.repeat(grip.give / (1 + folded), 3)
        free = grip.give > 0
        energy = (size * (1 + folded / 2))[free] / grip.give[free]
        self.cost = float(self.gap @ self.gap) / self.tolerance + float(energy.sum())

    def step(self, damping: float) -> Float64[np.ndarray, "n 3"]:
        """Minimise the linearised cost plus `damping` times the energy of the step; shortened to `STEP_RAD`."""
        share = 1 / (1 + damping)
        soft, bend = share * self.soft, self.bend.ravel()
        aim = self.gap + share * (self.jacobian @ bend)
        dual = np.linalg.solve((self.jacobian * soft) @ self.jacobian.T + self.tolerance * np.eye(3), aim)
        step = (soft * (self.jacobian.T @ dual) - share * bend).reshape(-1, 3)
        return np.asarray(step * min(1.0, STEP_RAD / max(float(np.linalg.norm(step, axis=1).max()), 1e-12)))


@compiled
@no_type_check  # numba compiles no checked function
def _reach(segments, bends):
    """Displacement of the point, and its derivatives by the bends [3, n, 3]."""
    n = len(segments)
    before, frame = np.empty((n, 3, 3)), np.eye(3)
    arms, jacobian, moved = np.empty((n, 3)), np.empty((3, n, 3)), np.zeros(3)
    by_turn = np.empty((n, 3, 3))
    for i in range(n - 1, -1, -1):  # from the root
        before[i] = frame
        turn, by_turn[i] = exponential(bends[i])
        frame = product(frame, turn)
        arms[i] = turned(frame, segments[i])
        moved += arms[i] - segments[i]
    arm = np.zeros(3)
    for i in range(n):
        arm += arms[i]
        jacobian[:, i] = -product(cross_matrix(arm), product(before[i], by_turn[i]))
    return moved, jacobian
