"""Solve for the bends of the joints that bring a dragged point to its target.

The unknowns are κ_i of the joints (`joints.py`) from the pulled one towards the root. The solution has the least energy
of all bends that bring the point to its target x*:

    E(κ) = ½ Σ_i |κ_i|² (1 + ⅓ (|κ_i| / κ_max)⁴) / g_i

with g_i = |r_i| / (carried_i² Π_f s_f), |r_i| the length to the next joint and carried_i the number of voxels beyond:
the compliance of a beam whose cross-section is that of all branches it carries, over its share s_f of the stem at each
fork where it branches off; far less where a bend would tear a one-surface crown (`Joints.compliance`). A trunk stands
while its twig is pulled, and no joint folds. The dragged point is at

    x = x_0 + Σ_i (A_i - 1) s_i,      A_i = A_{i+1} exp[κ_i]×,      i counts from the tip, and A is 1 beyond the last

s_i leads from joint i to the next one, or to the point, times the share carried beyond. Newton's step rotates the
segments a_i = A_i s_i in space by θ_i, like a rod whose end is pulled with the force λ:

    k_i (θ_i - θ_{i+1}) - k_{i-1} (θ_{i-1} - θ_i) + max(a_i · λ, 0) θ_i  =  a_i × λ - (m_i - m_{i-1})

with m_i and k_i the moment and the stiffness of joint i, and Σ_i θ_i × a_i + ε λ = x* - x. Due to ε a point misses its
target by 1 % if that takes 30,000 times the force of a small pull, as along a stem or into a fold. A step that neither
brings the point nearer nor lowers E is repeated shorter. `web/motion/pin.js` implements `equilibrium` too.
"""

from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int64

from dynamictree.modal.force import CarriedPoint
from dynamictree.modal.joints import Joints, cross_matrix, exponential
from dynamictree.parallel import compiled

MAX_STEP_RAD = 0.5  # largest rotation of a joint per iteration
CONVERGED_RAD, MIN_STEP_RAD = 1e-3, 1e-6  # full step that is the last; shortened step that ends the search
MAX_BEND_RAD = 0.4  # κ_max


@dataclass(frozen=True, kw_only=True)
class Pull:
    """Static solution for a dragged point."""

    bend: Float64[np.ndarray, "n 3"]  # κ from the grip's own joint towards the root
    reached_m: Float64[np.ndarray, " 3"]
    beyond_m: float  # distance of the target beyond the straightened chain [m]


@dataclass(frozen=True, kw_only=True)
class Grip:
    """Point that can be pulled, prepared once for any target."""

    segments_m: Float64[np.ndarray, "n 3"]  # s, segments at rest
    compliance: Float64[np.ndarray, " n"]  # g, compliances
    tolerance: float  # ε, compliance of the constraint


def grip_at(joints: Joints, chain: Int64[np.ndarray, " n"], point: CarriedPoint) -> Grip:
    """Prepare the grip at a point with its chain of joints."""
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
    compliance = joints.compliance[chain] * np.linalg.norm(ends - place, axis=1)
    return grip_of(segments, compliance)


def grip_of(segments_m: Float64[np.ndarray, "n 3"], compliance: Float64[np.ndarray, " n"]) -> Grip:
    """Create a grip from the segments at rest and their compliances."""
    of_point = float(2 * compliance @ (np.cumsum(segments_m, axis=0) ** 2).sum(axis=1))  # value at rest
    return Grip(segments_m=segments_m, compliance=compliance, tolerance=3e-7 * of_point)


def pull_to(grip: Grip, target_m: Float64[np.ndarray, " 3"], *, near: Float64[np.ndarray, "n 3"] | None = None) -> Pull:
    """Bring the point as near to its target [m from rest] as possible; `near` is the bend for a nearby target."""
    still = np.zeros_like(grip.segments_m)
    if grip.tolerance <= 0:
        return Pull(bend=still, reached_m=np.zeros(3), beyond_m=0.0)
    within, beyond = _within_length(grip.segments_m, target_m)
    return replace(equilibrium(grip, within, still if near is None else near), beyond_m=beyond)


def equilibrium(grip: Grip, target_m: Float64[np.ndarray, " 3"], bend: Float64[np.ndarray, "n 3"]) -> Pull:
    """Find the bend of least energy with the point at a reachable target, starting from a first guess."""
    compliance = np.maximum(grip.compliance, 1e-14 * grip.compliance.sum())  # a joint without length is rigid
    bend, reached = _solve(grip.segments_m, compliance, grip.tolerance, target_m, bend)
    return Pull(bend=bend, reached_m=reached, beyond_m=0.0)


def _within_length(
    segments: Float64[np.ndarray, "n 3"], target_m: Float64[np.ndarray, " 3"]
) -> tuple[Float64[np.ndarray, " 3"], float]:
    """Return the reachable point nearest to a target, with some slack, and the target's distance beyond [m].

    Towards a target at the full length or beyond, bends grow without bounds, and a crooked branch is never drawn
    straight. A straight chain that bends evenly until its chord has rotated by φ is shortened to sin φ / φ of its
    length. A chain with one long segment cannot fold nearer to the root than the other segments allow.
    """
    slack_share = 0.03  # share of the pull by which a drag stays within the length of the branches
    drawn = 0.7  # share of a crooked branch's excess length by which it can be straightened
    chord, sizes = segments.sum(axis=0), np.linalg.norm(segments, axis=1)
    arm = chord + target_m  # vector from the root to the target
    distance, straight = float(np.linalg.norm(arm)), float(np.linalg.norm(chord))
    length = straight + drawn * (float(sizes.sum()) - straight)
    turned = float(np.arctan2(np.linalg.norm(np.cross(chord, arm)), chord @ arm))  # φ
    slack = slack_share * float(np.linalg.norm(target_m))
    longest = max(length - slack, straight * float(np.sinc(turned / np.pi)))
    shortest = min(2 * float(sizes.max()) - float(sizes.sum()) + slack, straight)
    within = target_m + (np.clip(distance, shortest, longest) / max(distance, 1e-12) - 1) * arm
    return within, max(0.0, distance - length)


@compiled
@no_type_check  # numba cannot compile a type-checked function
def _solve(segments, compliance, tolerance, target, bends):
    """Iterate to the equilibrium; return the bends and the point's displacement."""
    rounds, force, price, longest = 120, np.zeros(3), 0.0, MAX_STEP_RAD
    before, arms, reached, energy = _forward(segments, compliance, bends)
    for _ in range(rounds):
        gap = target - reached
        turns, moved = _turns(before, arms, bends, compliance, force)
        force = np.linalg.solve(moved[:, :3] + tolerance * np.eye(3), gap + moved[:, 3])
        step = _bend_steps(before, bends, turns, force)
        price = max(price, 1.5 * np.linalg.norm(force))  # penalty of the gap, above the constraint's multiplier
        size = np.sqrt((step**2).sum(axis=1).max())
        further = bends + min(1.0, longest / max(size, MIN_STEP_RAD)) * step
        tried = _forward(segments, compliance, further)
        if tried[3] - energy > price * (np.linalg.norm(gap) - np.linalg.norm(target - tried[2])):
            longest = 0.3 * min(longest, size)
            if longest < MIN_STEP_RAD:
                break
            continue
        bends, (before, arms, reached, energy) = further, tried
        if size <= min(longest, CONVERGED_RAD):
            break
        longest = min(MAX_STEP_RAD, 2 * longest)
    return bends, reached


@compiled
@no_type_check
def _forward(segments, compliance, bends):
    """Return the frame before each joint [n, 3, 3], the rotated segments, the point's displacement, and E."""
    before, arms = np.empty((len(bends), 3, 3)), np.empty_like(segments)
    frame, moved = np.eye(3), np.zeros(3)
    for i in range(len(bends) - 1, -1, -1):  # order from the root
        before[i] = frame
        frame = frame @ exponential(bends[i])
        arms[i] = frame @ segments[i]
        moved += arms[i] - segments[i]
    square = (bends**2).sum(axis=1)
    return before, arms, moved, 0.5 * (square * (1 + (square / MAX_BEND_RAD**2) ** 2 / 3) / compliance).sum()


@compiled
@no_type_check
def _turns(before, arms, bends, compliance, force):
    """Compute θ of each segment for a force along each axis and for the moments [n, 3, 4], and the point's motions."""
    n = len(arms)
    folded = ((bends**2).sum(axis=1) / MAX_BEND_RAD**2) ** 2
    stiffness = (1 + 5 * folded) / compliance
    turns = np.empty((n, 3, 4))  # first the right-hand sides, then the solution
    tension = np.empty(n)  # geometric stiffness of the segments up to this one
    below = np.zeros(3)
    for i in range(n):
        moment = before[i] @ bends[i] * (1 + folded[i]) / compliance[i]
        turns[i, :, :3] = cross_matrix(arms[i])
        turns[i, :, 3] = moment - below
        below = moment
        tension[i] = max((arms[i] * force).sum(), 0.0)
        if i:
            share = stiffness[i - 1] / (stiffness[i - 1] + tension[i - 1])
            tension[i] += share * tension[i - 1]
            turns[i] += share * turns[i - 1]
    above, moved = np.zeros((3, 4)), np.zeros((3, 4))
    for i in range(n - 1, -1, -1):
        turns[i] = (turns[i] + stiffness[i] * above) / (stiffness[i] + tension[i])
        above = turns[i]
        moved -= cross_matrix(arms[i]) @ above
    return turns, moved


@compiled
@no_type_check
def _bend_steps(before, bends, turns, force):
    """Compute the step of each κ under a force."""
    step, below = np.empty_like(bends), np.zeros(3)
    for i in range(len(bends) - 1, -1, -1):
        turn = turns[i] @ np.append(force, -1.0)
        own = before[i].T @ (turn - below)
        again = np.cross(bends[i], own)
        step[i] = own - again / 2 + np.cross(bends[i], again) / 12  # step of κ for a rotation in its frame
        below = turn
    return step
