"""Solve for the force and the local bend that hold a point where a drag wants it, in the bent shape.

Unknowns are the answer of the modes to a force f at the point, and a bend κ_b of each joint between the point and the
root. Of all that bring the point to its target x*, the solution has the least energy:

    |x* − x(f, κ)|² / 2ε  +  ½ fᵀ C f (1 + ½ s²)  +  ½ Σ_b |κ_b|² (1 + ½ |κ_b|² / κ_max²) / g_b

with x the drawn point, which its own bones carry, g_b = β |r_b| / carried_b^p, |r_b| the bone's length and carried_b
the number of voxels beyond the joint. C is the compliance of the modes and s the largest turn that they give a bone,
over `LARGEST_TURN`. So a branch bends at its thin end more than at its thick one, and no joint folds. ε is so small
that it only matters for a target that cannot be reached, such as one along a stem. Levenberg-Marquardt; because the
point has three coordinates, each step is the solution of a 3 × 3 system.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Float64, Int64

from dynamictree.modal.bone_chain import Place, place_of, reach
from dynamictree.modal.bones import Bones
from dynamictree.modal.force import CarriedPoint, Contact, compliance, generalised
from dynamictree.modal.system import ModalSystem
from dynamictree.modal.warp import bone_turns

BEND_SHARE = 400.0  # β makes the chain so many times as compliant at the point as the modes
STIFFENING = 1.0  # p
LARGEST_TURN = 0.4  # of one bone by the modes [rad]; beyond it they stiffen
LARGEST_BEND = 0.5  # κ_max, of one joint [rad]
TOLERANCE = 1e-6  # ε over the compliance of the softest direction
SOFT = 1e-3  # directions that give way by a smaller share of the softest are stiff
ROUNDS = 120
SETTLED = 3e-4  # of the target: a step that changes the point by less is the last
STEP_RAD = 0.5
SLACK = 0.03  # of the pull: a drag ends so far within the length of the branches
_ACCEPT, _REFUSE = 0.25, 6.0  # factors of Levenberg's damping


@dataclass(frozen=True, kw_only=True)
class Pull:
    """A point at rest under a drag. `bend` is κ of the bones from the grip's own towards the root."""

    force_n: Float64[np.ndarray, " 3"]
    bend: Float64[np.ndarray, "c 3"]
    unknowns: Float64[np.ndarray, " D"]  # a first guess for a target near this one
    reached_m: Float64[np.ndarray, " 3"]
    beyond_m: float  # how much too short the chain is, drawn straight [m]


@dataclass(frozen=True, kw_only=True)
class Grip:
    """One place that can be pulled, prepared once for any target."""

    place: Place
    joints: Int64[np.ndarray, " c"]  # row of each joint that may bend among the place's bones, from the tip to the root
    force_per_unit: Float64[np.ndarray, "3 S"]  # f of unit energy in each soft direction of the modes
    turns_per_unit: Float64[np.ndarray, "n3 S"]  # θ of the place's bones, likewise
    give: Float64[np.ndarray, " n3"]  # g, three times [rad²/J]
    tolerance_m2_j: float
    largest: float = field(default=1.0)  # units at which some bone turns by `LARGEST_TURN`


def carried_voxels(bones: Bones) -> Int64[np.ndarray, " B"]:
    """Number of voxels that each bone carries, its own included."""
    count = np.bincount(bones.bone_of_voxel, minlength=len(bones.parent))
    for bone in range(len(count) - 1, 0, -1):  # parents come before children
        if bones.parent[bone] >= 0:
            count[bones.parent[bone]] += count[bone]
    return np.asarray(count)


def grip_at(
    system: ModalSystem,
    bones: Bones,
    at: Contact,
    weights: Float32[np.ndarray, "1 B"],
    chain: Int64[np.ndarray, " c"],
) -> Grip:
    """Prepare a place; `weights` are those of its group's bones, and the joints of the chain may bend."""
    row = int(at.rows[0])
    own = CarriedPoint(
        point_m=system.grid.centres_m[row],
        bones=bones.bone_of_voxel[row : row + 1],
        weights=np.ones(1, np.float32),
    )
    drawn = at.drawn or own
    place = place_of(bones, drawn.point_m, drawn.bones, drawn.weights)
    n = len(place)
    softness, axes = np.linalg.eigh(compliance(system, at))
    soft = (softness > SOFT * softness[-1]) & (softness > 0)
    force = axes[:, soft] / np.sqrt(softness[soft])
    coordinates = [(generalised(system, at, f) / system.stiffness)[None] for f in force.T]
    turns = np.zeros((len(bones.parent), 3, len(coordinates)))
    for index, q in enumerate(coordinates):
        turns[:, :, index] = bone_turns(bones, weights, q)
    largest_turn = np.sqrt((turns**2).sum(axis=(1, 2))).max(initial=0)
    per_unit = turns[place.bones].reshape(3 * n, len(coordinates))
    _, by_turns, by_bends = reach(place, np.zeros((n, 3)), np.zeros((n, 3)))
    modal = by_turns @ per_unit
    through_modes = modal @ modal.T
    joints = np.where(np.isin(chain, place.bones), place.bones.searchsorted(chain), -1)
    shape = np.zeros(n)
    shape[joints[joints >= 0]] = 1
    length = np.linalg.norm(bones.reach_m[place.bones], axis=1)
    give = np.repeat(shape * length / carried_voxels(bones)[place.bones] ** STIFFENING, 3)
    if give.any():
        alike = np.trace(through_modes) or 1.0  # where no mode moves the point, only the shape of the bend matters
        give *= BEND_SHARE * alike / np.trace((by_bends * give) @ by_bends.T)
    softest = np.linalg.eigvalsh(through_modes + (by_bends * give) @ by_bends.T)[-1]
    return Grip(
        place=place,
        joints=joints,
        force_per_unit=force,
        turns_per_unit=per_unit,
        give=give,
        tolerance_m2_j=TOLERANCE * float(softest),
        largest=LARGEST_TURN / max(float(largest_turn), np.finfo(np.float64).tiny),
    )


def pull_to(grip: Grip, target_m: Float64[np.ndarray, " 3"], *, near: Pull | None = None) -> Pull:
    """Bring the point as near to its target as it can go [m from rest]; `near` is the answer for a target close by."""
    n, num_soft = len(grip.place), grip.force_per_unit.shape[1]
    y = np.zeros(num_soft + 3 * n) if near is None else near.unknowns  # units of the modes, then κ
    if n == 0 or grip.tolerance_m2_j <= 0:
        still = np.zeros(3)
        return Pull(force_n=still, bend=_of_chain(grip, y), unknowns=y, reached_m=still, beyond_m=0.0)
    within, beyond = _within_length(grip.place, target_m)
    damping = 0.1
    now = _Linear(grip, y, within)
    settled = SETTLED * float(np.linalg.norm(target_m))
    for _ in range(ROUNDS):
        step = now.step(damping)
        largest = float(np.abs(np.concatenate([grip.turns_per_unit @ step[:num_soft], step[num_soft:]])).max())
        tried = _Linear(grip, y + step * min(1.0, STEP_RAD / max(largest, 1e-12)), within)
        if not tried.cost < now.cost:
            damping *= _REFUSE
            if damping > 1e8:
                break
            continue
        moved = float(np.linalg.norm(tried.reached - now.reached))
        y, now, last = tried.y, tried, damping
        damping = max(damping * _ACCEPT, 1e-9)
        if moved < settled and last < 1e-2:
            break
    return Pull(
        force_n=grip.force_per_unit @ y[:num_soft],
        bend=_of_chain(grip, y),
        unknowns=y,
        reached_m=now.reached,
        beyond_m=beyond,
    )


def _of_chain(grip: Grip, unknowns: Float64[np.ndarray, " D"]) -> Float64[np.ndarray, "c 3"]:
    bends = unknowns[grip.force_per_unit.shape[1] :].reshape(-1, 3)
    return np.asarray(np.concatenate([bends, np.zeros((1, 3))])[grip.joints])


def _within_length(place: Place, target_m: Float64[np.ndarray, " 3"]) -> tuple[Float64[np.ndarray, " 3"], float]:
    """The place nearest to a target that the chain reaches with some slack, and how far the target is beyond it [m].

    Towards a place at the whole length or beyond, forces grow without bounds. A straight chain that bends evenly
    until its chord has turned by φ is as short as sin φ / φ of its length.
    """
    chord = place.segments_m.sum(axis=0)
    arm = chord + target_m  # from the root to the target
    distance, length = float(np.linalg.norm(arm)), float(np.linalg.norm(place.segments_m, axis=1).sum())
    straight = float(np.linalg.norm(chord))
    turned = float(np.arctan2(np.linalg.norm(np.cross(chord, arm)), chord @ arm))  # φ
    longest = max(length - SLACK * float(np.linalg.norm(target_m)), straight * float(np.sinc(turned / np.pi)))
    within = target_m - max(1 - longest / max(distance, 1e-12), 0.0) * arm
    return within, max(0.0, distance - length)


class _Linear:
    """The problem around one guess: value, Jacobian and weights of the energy."""

    def __init__(self, grip: Grip, y: Float64[np.ndarray, " D"], target_m: Float64[np.ndarray, " 3"]) -> None:
        num_soft = grip.force_per_unit.shape[1]
        units, bend = y[:num_soft], y[num_soft:].reshape(-1, 3)
        turns = (grip.turns_per_unit @ units).reshape(-1, 3)
        self.y = y
        self.reached, by_turns, by_bends = reach(grip.place, turns, bend)
        self.jacobian = np.concatenate([by_turns @ grip.turns_per_unit, by_bends], axis=1)
        self.gap = target_m - self.reached
        self.tolerance = grip.tolerance_m2_j
        strong = float(units @ units) / grip.largest**2
        folded = (bend**2).sum(axis=1) / LARGEST_BEND**2  # [n]
        stiffer = np.concatenate([np.full(num_soft, 1 + strong), np.repeat(1 + folded, 3)])
        self.soft = np.concatenate([np.ones(num_soft), grip.give]) / stiffer
        relaxed = np.concatenate([np.full(num_soft, 1 + strong / 2), np.repeat(1 + folded / 2, 3)])
        free = self.soft > 0
        energy = (y**2 * relaxed)[free] / (self.soft * stiffer)[free]
        self.cost = float(self.gap @ self.gap) / self.tolerance + float(energy.sum())

    def step(self, damping: float) -> Float64[np.ndarray, " D"]:
        """Minimise the linearised cost plus `damping` times the energy of the step."""
        scaled_multipliers = damping / (1 + damping) * self.y
        soft = self.soft / (1 + damping)
        aim = self.gap + self.jacobian @ (self.y - scaled_multipliers)
        dual = np.linalg.solve((self.jacobian * soft) @ self.jacobian.T + self.tolerance * np.eye(3), aim)
        return np.asarray(scaled_multipliers + soft * (self.jacobian.T @ dual) - self.y)
