"""Wind simulation: each stem is an elastic rod on its moving parent; leaves are rigid cards on springs.

`oscillator` gives each stem's deflection. Here it becomes a chain of turns: every segment takes its share of the bend,
Weber and Penn's (1 − z) / r, and children inherit. Turns are exact, so that nothing stretches.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64, Int, Int32, Int64

from dynamictree.parallel import single_thread
from dynamictree.spectrum import NUM_FRAMES, Wind
from lab.dataset.branching import Stems
from lab.dataset.leaves import Leaves
from lab.dataset.motion import Sway
from lab.dataset.oscillator import (
    Gusts,
    answer,
    clock,
    damping_ratio,
    delay,
    gusts_of,
    leaf_lean_angle,
    lean_angle,
    stem_bin,
    stray,
)
from lab.dataset.rotation import carried, cross, product, to_matrix, turn_of
from lab.dataset.sapling import Tree
from lab.dataset.tubes import own_rings

ABOVE_FLARE = 0.15  # of a trunk's length; Weber and Penn's flare ends at 1/8
TRUNK_BEND = 0.6
"""Lean of a trunk, over that of a branch as slender: with the usual flare as much as by the radius at the ground."""


@dataclass(frozen=True, kw_only=True)
class _Pose:
    """Position and rotation of some stems at one ring; `_move` updates the arrays in place."""

    place: Float32[np.ndarray, "3 M T"]  # of the ring's centre [m]
    turn: Float32[np.ndarray, "4 M T"]  # quaternion
    linear: Complex64[np.ndarray, "M J 3"]  # first-order motion of the centre [m], for what sits on it
    linear_turn: Complex64[np.ndarray, "M J 3"]
    phase: Float32[np.ndarray, "M J 3"]  # how far the gusts' phases strayed

    def of(self, rows: Int[np.ndarray, " C"]) -> "_Pose":
        """The pose of some of the stems."""
        return _Pose(
            place=self.place[:, rows],
            turn=self.turn[:, rows],
            linear=self.linear[rows],
            linear_turn=self.linear_turn[rows],
            phase=self.phase[rows],
        )


@dataclass(frozen=True, kw_only=True)
class _Moving:
    """Motion of all stems of one level."""

    place: Float32[np.ndarray, "P 3 M T"]  # by ring
    turn: Float32[np.ndarray, "R 4 M T"]  # by segment
    linear: Complex64[np.ndarray, "P M J 3"]
    linear_turn: Complex64[np.ndarray, "R M J 3"]
    phase: Float32[np.ndarray, "M J 3"]

    def at(self, row: Int32[np.ndarray, " C"], ring: Float32[np.ndarray, " C"]) -> _Pose:
        """The pose of points on stems, `ring` in rings: rigid on the segment they lie in."""
        on = np.minimum(ring.astype(np.int32), len(self.turn) - 1)
        along = (ring - on).astype(np.float32)[:, None, None]
        low, high = self.place[on, :, row], self.place[on + 1, :, row]  # [C, 3, T]
        base = self.linear[on, row]
        return _Pose(
            place=(low + along * (high - low)).transpose(1, 0, 2),
            turn=self.turn[on, :, row].transpose(1, 0, 2),
            linear=base + along * (self.linear[on + 1, row] - base),
            linear_turn=self.linear_turn[on, row],
            phase=self.phase[row],
        )


def sway(
    tree: Tree,
    wind: Wind,
    rng: np.random.Generator,
    *,
    num_frames: int = NUM_FRAMES,
    loop: bool = True,
    times: int = 1,
) -> Sway:
    """Move a tree in the wind for `num_frames` frames at 24 fps; a loop has `times` T of them."""
    return sway_stems(
        tree.stems, wind, rng, leaves=tree.leaves, bare=tree.bare, num_frames=num_frames, loop=loop, times=times
    )


def sway_stems(
    levels: tuple[Stems, ...],
    wind: Wind,
    rng: np.random.Generator,
    *,
    bare: bool,
    leaves: tuple[Leaves, ...] = (),
    num_frames: int = NUM_FRAMES,
    loop: bool = True,
    times: int = 1,
) -> Sway:
    """Move stems, level after level, and the leaves on them. Nodes are the stems' own rings, then the leaves."""
    gusts = gusts_of(wind, rng, loop=loop, times=times)
    ticks = clock(gusts, num_frames)
    moving: list[_Moving] = []
    motions = []
    with single_thread():
        for stems in levels:
            moving.append(_move(stems, moving[-1] if moving else None, gusts, ticks, rng, bare=bare))
            motions.append(_ring_motion(stems, moving[-1]))
        for bunch in leaves:
            motions.append(_flutter(bunch, moving[bunch.level], gusts, ticks, rng))
    return Sway(
        shift=np.concatenate([motion.shift for motion in motions], axis=1),
        turn=np.concatenate([motion.turn for motion in motions], axis=1),
        position=np.concatenate([motion.position for motion in motions]),
    )


def _move(
    stems: Stems,
    parent: _Moving | None,
    gusts: Gusts,
    ticks: Complex64[np.ndarray, "J T"],
    rng: np.random.Generator,
    *,
    bare: bool,
) -> _Moving:
    """Walk all stems of a level from ring to ring, turning each segment by what came before and its own bend."""
    lean = lean_angle(stems.length_m, _bending_radius(stems, is_trunk=parent is None), gusts.wind.speed_m_s)
    own_bin, damping = stem_bin(stems.length_m, bare=bare), damping_ratio(bare=bare)
    share = _bending_share(stems, still_root=parent is None)
    pose = _upright(stems.points[:, 0], ticks)
    angle = np.zeros_like(pose.linear)
    deflection = np.zeros_like(pose.place)
    place, turn, linear, linear_turn = [], [], [], []
    for ring in range(stems.segments):
        born = np.flatnonzero(stems.first == ring)
        if len(born):
            _take_over(pose, born, _begin(stems, born, pose, parent))
            pose.phase[born] += stray(gusts, len(born), rng)
            driven = pose.phase[born] + gusts.phase - delay(gusts, stems.points[born, ring])
            base_angle = pose.linear[born] @ gusts.axes.T / stems.length_m[born][:, None, None]
            reply = answer(gusts, lean[born], own_bin[born], driven, base_angle, damping=damping)
            angle[born] = reply @ gusts.axes
            deflection[:, born] = _in_time(angle[born], lean[born], gusts, ticks)
        place.append(pose.place.copy())
        linear.append(pose.linear.copy())
        _step(pose, stems.points[:, ring + 1] - stems.points[:, ring], share[:, ring], deflection, angle)
        turn.append(pose.turn.copy())
        linear_turn.append(pose.linear_turn.copy())
    return _Moving(
        place=np.stack([*place, pose.place]),
        turn=np.stack(turn),
        linear=np.stack([*linear, pose.linear]),
        linear_turn=np.stack(linear_turn),
        phase=pose.phase,
    )


def _upright(base: Float32[np.ndarray, "M 3"], ticks: Complex64[np.ndarray, "J T"]) -> _Pose:
    """Pose of all stems at rest."""
    count, (num_bins, num_frames) = len(base), ticks.shape
    turn = np.zeros((4, count, num_frames), np.float32)
    turn[0] = 1
    return _Pose(
        place=np.broadcast_to(base.T[:, :, None], (3, count, num_frames)).copy(),
        turn=turn,
        linear=np.zeros((count, num_bins, 3), np.complex64),
        linear_turn=np.zeros((count, num_bins, 3), np.complex64),
        phase=np.zeros((count, num_bins, 3), np.float32),
    )


def _begin(stems: Stems, born: Int64[np.ndarray, " C"], pose: _Pose, parent: _Moving | None) -> _Pose:
    """Pose at the base of stems: on the stem they split from, on the parent's segment, or on the ground (trunk)."""
    source = stems.parent[born]
    if stems.first[born[0]] > 0:
        return pose.of(source)
    if parent is not None:
        return parent.at(source, stems.parent_ring[born])
    return pose.of(born)


def _take_over(pose: _Pose, born: Int64[np.ndarray, " C"], begin: _Pose) -> None:
    pose.place[:, born], pose.turn[:, born] = begin.place, begin.turn
    pose.linear[born], pose.linear_turn[born] = begin.linear, begin.linear_turn
    pose.phase[born] = begin.phase


def _step(
    pose: _Pose,
    segment: Float32[np.ndarray, "M 3"],
    share: Float32[np.ndarray, " M"],
    deflection: Float32[np.ndarray, "3 M T"],
    angle: Complex64[np.ndarray, "M J 3"],
) -> None:
    """Rotate by one segment's share of the bend, and move to the end of the segment."""
    axis = segment / np.maximum(np.linalg.norm(segment, axis=1, keepdims=True), 1e-9)
    bend = share[None, :, None] * cross(axis.T[:, :, None], deflection)
    pose.turn[:] = product(pose.turn, turn_of(bend))
    pose.linear_turn[:] = pose.linear_turn + share[:, None, None] * np.cross(axis[:, None], angle)
    pose.place[:] = pose.place + carried(pose.turn, segment.T[:, :, None])
    pose.linear[:] = pose.linear + np.cross(pose.linear_turn, segment[:, None])


def _in_time(
    angle: Complex64[np.ndarray, "M J 3"],
    lean: Float64[np.ndarray, " M"],
    gusts: Gusts,
    ticks: Complex64[np.ndarray, "J T"],
) -> Float32[np.ndarray, "3 M T"]:
    """Deflection of each stem along x, y, z at each frame, about the lean downwind [rad]."""
    stacked = np.concatenate([angle.real, -angle.imag], axis=1).transpose(2, 0, 1)  # [3, M, 2J]
    turning = stacked @ np.concatenate([ticks.real, ticks.imag])
    mean = (lean[:, None] * gusts.axes[0]).astype(np.float32)
    deflection: Float32[np.ndarray, "3 M T"] = (turning + mean.T[:, :, None]).astype(np.float32)
    return deflection


def _bending_radius(stems: Stems, *, is_trunk: bool) -> Float32[np.ndarray, " M"]:
    """Radius to which a stem's length is compared [m]: at its base, or of a trunk above its flare, as foresters do."""
    base: Float32[np.ndarray, " M"] = stems.radii[np.arange(len(stems.points)), stems.first]
    if not is_trunk:
        return base
    ring = ABOVE_FLARE * stems.segments
    low, along = int(ring), ring - int(ring)
    above_flare = (1 - along) * stems.radii[:, low] + along * stems.radii[:, low + 1]
    radius: Float32[np.ndarray, " M"] = np.where(stems.first > 0, base, above_flare / TRUNK_BEND).astype(np.float32)
    return radius


def _bending_share(stems: Stems, *, still_root: bool) -> Float32[np.ndarray, "M R"]:
    """Share of a stem's bend that each segment takes; 0 for the trunk's first segment, which is in the ground."""
    ring = np.arange(stems.segments)
    place = (ring - stems.first[:, None]) / (stems.segments + 1 - stems.first[:, None])
    share = np.where(ring >= stems.first[:, None], (1 - place) / stems.radii[:, :-1], 0)
    if still_root:
        share[:, 0] = 0
    normalised: Float32[np.ndarray, "M R"] = (share / share.sum(axis=1, keepdims=True)).astype(np.float32)
    return normalised


def _ring_motion(stems: Stems, moving: _Moving) -> Sway:
    """Motion of a level's nodes: a ring takes the mean turn of the segments that meet in it."""
    turn = to_matrix(moving.turn.transpose(1, 0, 2, 3))  # [3, 3, R, M, T]
    at_ring = np.concatenate([turn[:, :, :1], (turn[:, :, 1:] + turn[:, :, :-1]) / 2, turn[:, :, -1:]], axis=2)
    forked = stems.first > 0
    at_ring[:, :, stems.first[forked], forked] = turn[:, :, stems.first[forked], forked]
    own = own_rings(stems)
    shift = moving.place - stems.points.transpose(1, 2, 0)[:, :, :, None]  # [P, 3, M, T]
    return Sway(
        shift=np.ascontiguousarray(shift.transpose(3, 2, 0, 1)[:, own]),
        turn=np.ascontiguousarray(at_ring.transpose(4, 3, 2, 0, 1)[:, own]),
        position=stems.points[own],
    )


def _flutter(
    leaves: Leaves, bearer: _Moving, gusts: Gusts, ticks: Complex64[np.ndarray, "J T"], rng: np.random.Generator
) -> Sway:
    """Motion of leaves: each an oscillator of its own length on the stem's segment."""
    begin = bearer.at(leaves.row, leaves.ring)
    lean = np.full(len(leaves.base), leaf_lean_angle(gusts.wind.speed_m_s))
    driven = begin.phase + stray(gusts, len(lean), rng) + gusts.phase - delay(gusts, leaves.base)
    # a leaf is so much faster than what bears it that it follows at once
    angle = answer(gusts, lean, stem_bin(leaves.length_m), driven, np.zeros_like(begin.linear)) @ gusts.axes
    bend = cross(leaves.axis.T[:, :, None], _in_time(angle, lean, gusts, ticks))
    turn = to_matrix(product(begin.turn, turn_of(bend)))  # [3, 3, Q, T]
    shift = begin.place - leaves.base.T[:, :, None]
    return Sway(
        shift=np.ascontiguousarray(shift.transpose(2, 1, 0)),
        turn=np.ascontiguousarray(turn.transpose(3, 2, 0, 1)),
        position=leaves.base,
    )
