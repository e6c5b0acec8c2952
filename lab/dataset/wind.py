"""Wind simulation: each stem is an elastic rod on its moving parent; leaves are cards on springs that flutter.

`oscillator` computes each stem's deflection in the air at its place. This module converts it to a chain of rotations:
every segment takes its share of the bend, Weber and Penn's (1 − z) / r, and of the twist, and children inherit them.
Rotations are exact, so that nothing stretches.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float, Float32, Float64, Int, Int32, Int64
from scipy.fft import irfft, rfft

from dynamictree.parallel import single_thread
from dynamictree.spectrum import FPS, NUM_FRAMES, NUM_FREQUENCIES, Wind
from dynamictree.wind.air import Air, single_gust, turbulent_air
from dynamictree.wind.flutter import (
    FLAP_RAD,
    LINE_WIDTH,
    SLOWEST_HZ,
    TWIG_SHARE,
    TWIST_RAD,
    critical_speeds,
    leaf_frequencies,
    onset,
)
from lab.dataset.branching import Stems
from lab.dataset.leaves import Leaves
from lab.dataset.motion import Sway
from lab.dataset.oscillator import (
    CENTRE_OF_DRAG,
    LEAF_LEAN_RAD,
    LEAF_OWN_DAMPING,
    MAX_LEAN_RAD,
    TWIST_OVER_BEND,
    Load,
    base_radius,
    drag,
    driven_response,
    frequencies,
    limit_angles,
    loads_of,
    oscillators,
    simulated_law_hz,
)
from lab.dataset.rotation import product, quaternion_of, rotate, to_matrix
from lab.dataset.sapling import Tree
from lab.dataset.tubes import own_rings

ABOVE_FLARE_SHARE = 0.15  # share of the trunk's length; Weber and Penn's flare ends at 1/8
TRUNK_BEND = 0.6
"""Lean of a trunk over that of an equally slender branch; equals a lean by the radius at the ground (usual flare)."""


@dataclass(frozen=True, kw_only=True)
class _Pose:
    """Position and rotation of some stems at one ring; `_move` updates the arrays in place."""

    place: Float32[np.ndarray, "3 M T"]  # position of the ring's centre [m]
    turn: Float32[np.ndarray, "4 M T"]  # quaternion

    def of(self, rows: Int[np.ndarray, " C"]) -> "_Pose":
        """Select the pose of some of the stems."""
        return _Pose(place=self.place[:, rows], turn=self.turn[:, rows])


@dataclass(frozen=True, kw_only=True)
class _Moving:
    """Motion of all stems of one level."""

    place: Float32[np.ndarray, "P 3 M T"]  # positions by ring
    turn: Float32[np.ndarray, "R 4 M T"]  # quaternions by segment

    def at(self, row: Int32[np.ndarray, " C"], ring: Float32[np.ndarray, " C"]) -> _Pose:
        """Return the pose of points on stems, at position `ring` [rings]: rigid with their segment."""
        on = np.minimum(ring.astype(np.int32), len(self.turn) - 1)
        along = (ring - on).astype(np.float32)[:, None, None]
        low, high = self.place[on, :, row], self.place[on + 1, :, row]  # [C, 3, T]
        return _Pose(
            place=(low + along * (high - low)).transpose(1, 0, 2), turn=self.turn[on, :, row].transpose(1, 0, 2)
        )


def sway(tree: Tree, wind: Wind, rng: np.random.Generator, *, times: int = 1) -> Sway:
    """Move a tree in the wind through a loop of `times` T frames at 24 fps."""
    return sway_stems(tree.stems, wind, rng, leaves=tree.leaves, bare=tree.bare, times=times)


def sway_stems(
    levels: tuple[Stems, ...],
    wind: Wind,
    rng: np.random.Generator,
    *,
    bare: bool,
    leaves: tuple[Leaves, ...] = (),
    times: int = 1,
) -> Sway:
    """Move stems, level by level, and their leaves. Nodes are the stems' own rings, then the leaves."""
    times_s = np.arange(times * NUM_FRAMES) / FPS
    bins_hz = np.arange(1, NUM_FREQUENCIES * times) * FPS / NUM_FRAMES / times
    height_m = float(max(stems.points[:, :, 2].max() for stems in levels))
    air = turbulent_air(wind, height_m, bins_hz, times_s, rng)
    moving: list[_Moving] = []
    motions = []
    with single_thread():
        for stems, load in zip(levels, loads_of(levels, leaves, bare=bare), strict=True):
            moving.append(_move(stems, moving[-1] if moving else None, load, air))
            motions.append(_ring_motion(stems, moving[-1]))
        for bunch in leaves:
            motions.append(_leaf_motion(bunch, moving[bunch.level], air, rng))
    return Sway(
        shift=np.concatenate([motion.shift for motion in motions], axis=1),
        turn=np.concatenate([motion.turn for motion in motions], axis=1),
        position=np.concatenate([motion.position for motion in motions]),
    )


def free_motion(tree: Tree, times: int = 16) -> Float64[np.ndarray, " T"]:
    """Return the downwind displacement of the longest trunk's top after one gust of 1 s in still air [m].

    The loop has `times` T frames, in which the motion comes to rest before the next gust.
    """
    stems, load = tree.stems[0], loads_of(tree.stems, tree.leaves, bare=tree.bare)[0]
    moving = _move(stems, None, load, single_gust(np.arange(times * NUM_FRAMES) / FPS))
    longest = int(stems.length_m.argmax())
    return np.asarray(moving.place[-1, 0, longest] - stems.points[longest, -1, 0], np.float64)


def _move(stems: Stems, parent: _Moving | None, load: Load, air: Air) -> _Moving:
    """Move all stems of a level ring by ring; rotate each segment by the rotation before it and its own bend."""
    radius = _bending_radius(stems, is_trunk=parent is None)
    share = _bending_share(stems, still_root=parent is None)
    pose = _upright(stems.points[:, 0], air.ticks.shape[1])
    deflection = np.zeros_like(pose.place)
    twist = np.zeros_like(pose.place[0])
    place, turn = [], []
    for ring in range(stems.segments):
        born = np.flatnonzero(stems.first == ring)
        if len(born):
            begin = _begin(stems, born, pose, parent)
            pose.place[:, born], pose.turn[:, born] = begin.place, begin.turn
            own = Load(foliage=load.foliage[born], branches=load.branches[born], offset=load.offset[born])
            whole = stems.length_m[born] * stems.segments / (stems.segments - stems.first[born])
            stem = oscillators(stems.length_m[born], radius[born], own, whole if parent is None else None)
            passing = air.velocity(_centre_of_drag(stems, born)) + _mean_wind(air)
            base = begin.place - stems.points[born, ring].T[:, :, None]
            deflection[:, born] = stem.respond(passing, base)
            axis = stems.points[born, -1] - stems.points[born, ring]
            axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
            torque = np.einsum("cx,xct->ct", np.cross(axis, own.offset), stem.lean[:, None] * drag(passing))
            turned = driven_response(TWIST_OVER_BEND * torque, 2 * stem.omega, stem.damping_ratio)
            twist[born] = MAX_LEAN_RAD * np.tanh(turned / MAX_LEAN_RAD)
        place.append(pose.place.copy())
        _step(pose, stems.points[:, ring + 1] - stems.points[:, ring], share[:, ring], deflection, twist)
        turn.append(pose.turn.copy())
    return _Moving(place=np.stack([*place, pose.place]), turn=np.stack(turn))


def _mean_wind(air: Air) -> Float32[np.ndarray, "3 1 1"]:
    return np.asarray(air.wind.speed_m_s * air.axes[0], np.float32)[:, None, None]


def _centre_of_drag(stems: Stems, rows: Int64[np.ndarray, " C"]) -> Float32[np.ndarray, "C 3"]:
    first = stems.first[rows]
    ring = np.round(first + CENTRE_OF_DRAG * (stems.segments - first)).astype(np.int64)
    return np.asarray(stems.points[rows, ring])


def _upright(base: Float32[np.ndarray, "M 3"], num_frames: int) -> _Pose:
    """Return the pose of all stems at rest."""
    turn = np.zeros((4, len(base), num_frames), np.float32)
    turn[0] = 1
    return _Pose(place=np.broadcast_to(base.T[:, :, None], (3, len(base), num_frames)).copy(), turn=turn)


def _begin(stems: Stems, born: Int64[np.ndarray, " C"], pose: _Pose, parent: _Moving | None) -> _Pose:
    """Return the pose at the base of stems: on the stem they split from, on the parent's segment, or on the ground."""
    source = stems.parent[born]
    if stems.first[born[0]] > 0:
        return pose.of(source)
    if parent is not None:
        return parent.at(source, stems.parent_ring[born])
    return pose.of(born)


def _step(
    pose: _Pose,
    segment: Float32[np.ndarray, "M 3"],
    share: Float32[np.ndarray, " M"],
    deflection: Float32[np.ndarray, "3 M T"],
    twist: Float32[np.ndarray, "M T"],
) -> None:
    """Rotate by one segment's share of bend and twist, and move to the end of the segment."""
    axis = (segment / np.maximum(np.linalg.norm(segment, axis=1, keepdims=True), 1e-9)).T[:, :, None]
    bend = share[None, :, None] * (np.cross(axis, deflection, axis=0) + axis * twist)
    pose.turn[:] = product(pose.turn, quaternion_of(bend))
    pose.place[:] = pose.place + rotate(pose.turn, segment.T[:, :, None])


def _bending_radius(stems: Stems, *, is_trunk: bool) -> Float32[np.ndarray, " M"]:
    """Return the radius for a stem's slenderness [m]: at its base, or for a trunk above its flare, as foresters do."""
    base = base_radius(stems)
    if not is_trunk:
        return base
    ring = ABOVE_FLARE_SHARE * stems.segments
    low, along = int(ring), ring - int(ring)
    above_flare = (1 - along) * stems.radii[:, low] + along * stems.radii[:, low + 1]
    return np.asarray(np.where(stems.first > 0, base, above_flare / TRUNK_BEND), np.float32)


def _bending_share(stems: Stems, *, still_root: bool) -> Float32[np.ndarray, "M R"]:
    """Return each segment's share of a stem's bend; 0 for the trunk's first segment, which is in the ground."""
    ring = np.arange(stems.segments)
    place = (ring - stems.first[:, None]) / (stems.segments + 1 - stems.first[:, None])
    share = np.where(ring >= stems.first[:, None], (1 - place) / stems.radii[:, :-1], 0)
    if still_root:
        share[:, 0] = 0
    return np.asarray(share / share.sum(axis=1, keepdims=True), np.float32)


def _ring_motion(stems: Stems, moving: _Moving) -> Sway:
    """Return the motion of a level's nodes; a ring's rotation is the mean over its adjacent segments."""
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


def _leaf_motion(leaves: Leaves, bearer: _Moving, air: Air, rng: np.random.Generator) -> Sway:
    """Return the motion of leaves: each bends with the passing air, and flutters if the air is fast enough."""
    begin = bearer.at(leaves.row, leaves.ring)
    shift = begin.place - leaves.base.T[:, :, None]
    num_frames = shift.shape[2]
    # a leaf responds so much faster than its stem that it follows at once
    bearer_velocity = irfft(1j * frequencies(num_frames) * rfft(shift, axis=2), n=num_frames, axis=2)
    passing = air.velocity(leaves.base) + _mean_wind(air) - bearer_velocity
    angle = limit_angles(LEAF_LEAN_RAD * drag(passing))
    omega = 2 * np.pi * simulated_law_hz(leaves.length_m.astype(np.float64))
    lean = np.stack([driven_response(component, omega, LEAF_OWN_DAMPING) for component in angle])
    flap, twist = _flutter(leaves, np.sqrt((passing**2).sum(axis=0)), rng)
    axis, across = leaves.axis.T[:, :, None], leaves.normal.T[:, :, None]
    bend = np.cross(axis, (lean + across * flap).astype(np.float32), axis=0) + axis * twist
    turn = to_matrix(product(begin.turn, quaternion_of(bend)))  # [3, 3, Q, T]
    return Sway(
        shift=np.ascontiguousarray(shift.transpose(2, 1, 0)),
        turn=np.ascontiguousarray(turn.transpose(3, 2, 0, 1)),
        position=leaves.base,
    )


def _flutter(
    leaves: Leaves, speed_m_s: Float[np.ndarray, "Q T"], rng: np.random.Generator
) -> tuple[Float32[np.ndarray, "Q T"], Float32[np.ndarray, "Q T"]]:
    """Return the rotations of leaves across and about their axes [rad]."""
    count, num_frames = speed_m_s.shape
    hat = unit_turns(leaves.row, np.fft.rfftfreq(num_frames, d=1 / FPS), rng)
    unit = irfft(hat, n=num_frames, axis=2, norm="forward")  # [Q, 2, T]
    unit = unit * onset(speed_m_s, critical_speeds(count, rng))[:, None]
    return (FLAP_RAD * unit[:, 0]).astype(np.float32), (TWIST_RAD * unit[:, 1]).astype(np.float32)


def resonance(frequency_hz: Float64[np.ndarray, " J"], own_hz: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, "M J"]:
    """Return the amplitude of each leaf at each frequency of a loop; the squares sum to 1."""
    offset = (frequency_hz - own_hz[:, None]) / (LINE_WIDTH * own_hz[:, None])
    amplitude = np.sqrt(1 / (1 + offset**2)) * (frequency_hz >= SLOWEST_HZ)
    normalised: Float64[np.ndarray, "M J"] = amplitude / np.sqrt((amplitude**2).sum(axis=1, keepdims=True))
    return normalised


def unit_turns(
    twig: Int[np.ndarray, " M"], frequency_hz: Float64[np.ndarray, " J"], rng: np.random.Generator
) -> Complex64[np.ndarray, "M 2 J"]:
    """Sample spectra of each leaf's rotations across its axis and about it, of unit variance; `twig` numbers twigs."""
    twigs, own = np.unique(twig, return_inverse=True)
    own_hz = leaf_frequencies(len(twigs), rng)[own]
    of_twig, of_leaf = (
        rng.standard_normal((rows, 2, len(frequency_hz), 2), np.float32) @ np.array([1, 1j], np.complex64)
        for rows in (len(twigs), len(twig))
    )
    together = np.sqrt(TWIG_SHARE) * of_twig[own] + np.sqrt(1 - TWIG_SHARE) * of_leaf
    return np.asarray(0.5 * together * resonance(frequency_hz, own_hz)[:, None], np.complex64)
