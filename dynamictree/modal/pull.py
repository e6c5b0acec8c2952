"""Solve for the bends of the joints that hold a drawn point where a drag wants it.

Unknown are κ_i of the joints (`joints.py`) from the pulled one towards the root. Of all that bring the point to its
target x*, the solution has the least energy

    E(κ) = ½ Σ_i |κ_i|² (1 + ⅓ (|κ_i| / κ_max)⁴) / g_i

with g_i = |r_i| / (carried_i² Π_f s_f), |r_i| the length to the next joint and carried_i the number of voxels beyond:
the stiffness of a beam whose cross-section is that of all that it carries, times the share s_f that it takes of its
stem at each fork where it leaves one; where bending would tear a crown that is one surface, far less (`Joints.give`).
So a trunk stands while its twig is pulled, and no joint folds. The point that is drawn is at

    x = x_0 + Σ_i (A_i - 1) s_i,      A_i = A_{i+1} exp[κ_i]×,      i counts from the tip, and A is 1 beyond the last

s_i leads from joint i to the next one, or to the point, times the share that is carried beyond. Newton's step turns the
segments a_i = A_i s_i in space by θ_i, as a rod under the force λ that its end is pulled with:

    k_i (θ_i - θ_{i+1}) - k_{i-1} (θ_{i-1} - θ_i) + max(a_i · λ, 0) θ_i  =  a_i × λ - (m_i - m_{i-1})

with m_i and k_i the moment and the stiffness of joint i, and Σ_i θ_i × a_i + ε λ = x* - x. By ε a point misses a target
by 1 % where it takes 30,000 times the force of a small pull, as along a stem or into a fold. A step that neither brings
the point nearer nor lessens E is taken again, shorter. `web/motion/pin.js` has `equilibrium` too.
"""

from dataclasses import dataclass, replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int64

from dynamictree.modal.force import CarriedPoint
from dynamictree.modal.joints import Joints, cross_matrix, exponential
from dynamictree.parallel import compiled

STEP_RAD = 0.5  # that a joint turns in a round, at most
SETTLED_RAD, STUCK_RAD = 1e-3, 1e-6  # a whole step as small is the last; none as short is tried
LARGEST_BEND_RAD = 0.4  # κ_max


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
    compliance = float(2 * give @ (np.cumsum(segments_m, axis=0) ** 2).sum(axis=1))  # at rest
    return Grip(segments_m=segments_m, give=give, tolerance=3e-7 * compliance)


def pull_to(grip: Grip, target_m: Float64[np.ndarray, " 3"], *, near: Float64[np.ndarray, "n 3"] | None = None) -> Pull:
    """Bring the point as near to its target as it can go [m from rest]; `near` is the bend for a target close by."""
    still = np.zeros_like(grip.segments_m)
    if grip.tolerance <= 0:
        return Pull(bend=still, reached_m=np.zeros(3), beyond_m=0.0)
    within, beyond = _within_length(grip.segments_m, target_m)
    return replace(equilibrium(grip, within, still if near is None else near), beyond_m=beyond)


def equilibrium(grip: Grip, target_m: Float64[np.ndarray, " 3"], bend: Float64[np.ndarray, "n 3"]) -> Pull:
    """The bend of least energy that holds the point at a target within reach, from a first guess on."""
    give = np.maximum(grip.give, 1e-14 * grip.give.sum())  # a joint without length is rigid
    bend, reached = _settled(grip.segments_m, give, grip.tolerance, target_m, bend)
    return Pull(bend=bend, reached_m=reached, beyond_m=0.0)


def _within_length(
    segments: Float64[np.ndarray, "n 3"], target_m: Float64[np.ndarray, " 3"]
) -> tuple[Float64[np.ndarray, " 3"], float]:
    """The place nearest to a target that the chain reaches with some slack, and how far the target is beyond it [m].

    Towards a place at the whole length or beyond, bends grow without bounds, and a crook is never drawn straight. A
    straight chain that bends evenly until its chord has turned by φ is as short as sin φ / φ of its length. Nearer to
    the root than its longest segment leaves room for, no chain folds.
    """
    slack_share = 0.03  # of the pull: a drag ends so far within the length of the branches
    drawn = 0.7  # of how much longer a crooked branch is than straight: so far it can be drawn
    chord, sizes = segments.sum(axis=0), np.linalg.norm(segments, axis=1)
    arm = chord + target_m  # from the root to the target
    distance, straight = float(np.linalg.norm(arm)), float(np.linalg.norm(chord))
    length = straight + drawn * (float(sizes.sum()) - straight)
    turned = float(np.arctan2(np.linalg.norm(np.cross(chord, arm)), chord @ arm))  # φ
    slack = slack_share * float(np.linalg.norm(target_m))
    longest = max(length - slack, straight * float(np.sinc(turned / np.pi)))
    shortest = min(2 * float(sizes.max()) - float(sizes.sum()) + slack, straight)
    within = target_m + (np.clip(distance, shortest, longest) / max(distance, 1e-12) - 1) * arm
    return within, max(0.0, distance - length)


@compiled
@no_type_check  # numba compiles no checked function
def _settled(segments, give, tolerance, target, bends):
    """The bends, and how far they bring the point."""
    rounds, force, price, longest = 120, np.zeros(3), 0.0, STEP_RAD
    before, arms, reached, energy = _stance(segments, give, bends)
    for _ in range(rounds):
        gap = target - reached
        turns, moved = _turns(before, arms, bends, give, force)
        force = np.linalg.solve(moved[:, :3] + tolerance * np.eye(3), gap + moved[:, 3])
        step = _bent(before, bends, turns, force)
        price = max(price, 1.5 * np.linalg.norm(force))  # of the gap, above that of the constraint
        size = np.sqrt((step**2).sum(axis=1).max())
        further = bends + min(1.0, longest / max(size, STUCK_RAD)) * step
        tried = _stance(segments, give, further)
        if tried[3] - energy > price * (np.linalg.norm(gap) - np.linalg.norm(target - tried[2])):
            longest = 0.3 * min(longest, size)
            if longest < STUCK_RAD:
                break
            continue
        bends, (before, arms, reached, energy) = further, tried
        if size <= min(longest, SETTLED_RAD):
            break
        longest = min(STEP_RAD, 2 * longest)
    return bends, reached


@compiled
@no_type_check
def _stance(segments, give, bends):
    """What carries each segment [n, 3, 3], the turned segments, how far they bring the point, and E."""
    before, arms = np.empty((len(bends), 3, 3)), np.empty_like(segments)
    frame, moved = np.eye(3), np.zeros(3)
    for i in range(len(bends) - 1, -1, -1):  # from the root
        before[i] = frame
        frame = frame @ exponential(bends[i])
        arms[i] = frame @ segments[i]
        moved += arms[i] - segments[i]
    square = (bends**2).sum(axis=1)
    return before, arms, moved, 0.5 * (square * (1 + (square / LARGEST_BEND_RAD**2) ** 2 / 3) / give).sum()


@compiled
@no_type_check
def _turns(before, arms, bends, give, force):
    """θ of each segment for a force along each axis and for the moments [n, 3, 4], and how far each moves the point."""
    n = len(arms)
    folded = ((bends**2).sum(axis=1) / LARGEST_BEND_RAD**2) ** 2
    stiffness = (1 + 5 * folded) / give
    turns = np.empty((n, 3, 4))  # at first the right sides
    tension = np.empty(n)  # what stiffens the segments up to this one in space
    below = np.zeros(3)
    for i in range(n):
        moment = before[i] @ bends[i] * (1 + folded[i]) / give[i]
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
def _bent(before, bends, turns, force):
    """The step of each κ under a force."""
    step, below = np.empty_like(bends), np.zeros(3)
    for i in range(len(bends) - 1, -1, -1):
        turn = turns[i] @ np.append(force, -1.0)
        own = before[i].T @ (turn - below)
        again = np.cross(bends[i], own)
        step[i] = own - again / 2 + np.cross(bends[i], again) / 12  # of κ, for a turn in its frame
        below = turn
    return step
