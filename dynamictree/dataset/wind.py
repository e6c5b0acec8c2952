"""Sway: every stem an elastic rod that the wind drives, and that its parent carries.

A stem of length L is one damped oscillator a direction, of natural frequency 0.955 / √L Hz (the law of Sapling, whose
b = 1 / (4 √L) is in radians a frame of 1/24 s). The drag's mean bends it downwind by an angle that grows with L / r;
the gusts' bins drive it around that, and so does the motion of its base on the parent. The answer at bin k is

    q_k = H(k) (2 gust a_k θ e^{iψ_k} + (k / k_s)² u_k / L),    H(k) = 1 / (1 − (k / k_s)² + 2iζ k / k_s),

with θ the lean [rad], k_s the stem's bin, u_k the motion of its base [m] and ψ_k a phase: near the same for all stems at
low k, of each stem's own at high k. So geometry and wind fix the amplitude, and chance the phase. Bending follows
Weber and Penn's share (1 − z) / r along the stem; children inherit.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Float64, Int32

from dynamictree.dataset.branching import Stems
from dynamictree.dataset.leaves import Leaves
from dynamictree.dataset.rotation import carried, product, to_matrix, turn_of
from dynamictree.dataset.sapling import Tree
from dynamictree.dataset.tubes import own_rings
from dynamictree.spectrum import FPS, NUM_FRAMES, NUM_FREQUENCIES, Wind

FREQUENCY_AT_1M_HZ = 24 / (8 * np.pi)  # 0.955, times 1 / √L
REFERENCE_SPEED_M_S = 5.0
DRAG_EXPONENT = 1.4  # of the speed: leaves and twigs fold, so drag grows slower than its square (Vogel)
LEAN_RAD = np.deg2rad(1.5)  # whole bend of a stem of REFERENCE_SLENDERNESS at the reference speed
REFERENCE_SLENDERNESS = 60.0  # L / r
LEAF_LEAN_RAD = np.deg2rad(6.0)
MAX_LEAN_RAD = np.deg2rad(20.0)  # approached, never passed
DAMPING_RATIO = 0.15  # of a tree in leaf, mostly aerodynamic
TURBULENCE_EXPONENT = 0.5  # a_k ~ k^-0.5: wakes in the crown make the spectrum flatter than the free stream's
PHASE_SPREAD_RAD = 0.12  # a bin and a level: how far a stem's phase strays from its parent's
ACROSS = np.float32([1.0, 0.5, 0.35])  # drive along the wind, level across it, and vertical


@dataclass(frozen=True, kw_only=True)
class Sway:
    """Every node's rigid motion at every frame; a vertex at offset o from its node moves by shift + (turn) o."""

    shift: Float32[np.ndarray, "T B 3"]  # [m]
    turn: Float32[np.ndarray, "T B 3 3"]  # rotation less the identity
    position: Float32[np.ndarray, "B 3"]  # of nodes at rest [m]

    def every(self, step: int) -> "Sway":
        """Leave out all but each `step`-th frame."""
        return Sway(shift=self.shift[::step], turn=self.turn[::step], position=self.position)

    def vertices(self, rest: Float32[np.ndarray, "N 3"], node: Int32[np.ndarray, " N"]) -> Float32[np.ndarray, "T N 3"]:
        """Displacement of vertices, each with its node, at every frame [m]."""
        offset = rest - self.position[node]
        frames = zip(self.shift, self.turn, strict=True)
        return np.stack([shift[node] + np.einsum("nxy,ny->nx", turn[node], offset) for shift, turn in frames])


@dataclass(frozen=True, kw_only=True)
class Gusts:
    """What the wind does at each of its frequencies; the same for the whole tree."""

    wind: Wind
    bins: Float64[np.ndarray, " J"]  # in units of fps / T; whole numbers in loop mode
    phase: Float32[np.ndarray, "J 3"]
    axes: Float32[np.ndarray, "3 3"]  # along, across, up

    @property
    def amplitude(self) -> Float64[np.ndarray, " J"]:
        """a_k: of unit variance together."""
        power = self.bins ** (-2 * TURBULENCE_EXPONENT)
        return np.sqrt(2 * power / power.sum())


def gusts_of(wind: Wind, rng: np.random.Generator, *, loop: bool = True) -> Gusts:
    """Gust frequencies: the bins 1 to K - 1 of a loop, or, free, one at random near each."""
    bins = np.arange(1, NUM_FREQUENCIES, dtype=np.float64)
    if not loop:
        bins = bins + rng.uniform(-0.5, 0.5, len(bins))
    heading = np.deg2rad(wind.direction_deg)
    axes = np.float32([[np.cos(heading), np.sin(heading), 0], [-np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
    return Gusts(wind=wind, bins=bins, phase=rng.uniform(0, 2 * np.pi, (len(bins), 3)).astype(np.float32), axes=axes)


def stem_bin(length_m: Float32[np.ndarray, " M"]) -> Float64[np.ndarray, " M"]:
    """k_s: natural frequency of a stem in units of a bin; falls with length."""
    return FREQUENCY_AT_1M_HZ / np.sqrt(length_m.astype(np.float64)) * NUM_FRAMES / FPS


def lean_angle(
    length_m: Float32[np.ndarray, " M"], radius_m: Float32[np.ndarray, " M"], speed_m_s: float
) -> Float64[np.ndarray, " M"]:
    """θ: how far the mean wind bends a stem [rad]; grows with slenderness and speed, below MAX_LEAN_RAD."""
    drag = (speed_m_s / REFERENCE_SPEED_M_S) ** DRAG_EXPONENT
    linear = LEAN_RAD * drag * length_m.astype(np.float64) / radius_m / REFERENCE_SLENDERNESS
    return MAX_LEAN_RAD * np.tanh(linear / MAX_LEAN_RAD)


def answer(
    gusts: Gusts,
    lean: Float64[np.ndarray, " M"],
    own_bin: Float64[np.ndarray, " M"],
    phase: Float32[np.ndarray, "M J 3"],
    base_angle: Complex64[np.ndarray, "M J 3"],
) -> Complex64[np.ndarray, "M J 3"]:
    """q_k at the gusts' frequencies, in wind axes: `2 |q|` is an amplitude [rad]."""
    ratio = gusts.bins / own_bin[:, None]  # [M, J]
    transfer = 1 / (1 - ratio**2 + 2j * DAMPING_RATIO * ratio)
    drive = (gusts.wind.gust * gusts.amplitude * lean[:, None])[:, :, None] * ACROSS * np.exp(1j * phase)
    return (transfer[:, :, None] * (drive + (ratio**2)[:, :, None] * base_angle)).astype(np.complex64)


@dataclass(frozen=True, kw_only=True)
class _Moving:
    """One level in motion: what its children need."""

    place: Float32[np.ndarray, "R+1 3 M T"]  # of ring centres [m]
    turn: Float32[np.ndarray, "R 4 M T"]  # of segments, as quaternions
    phase: Float32[np.ndarray, "M J 3"]
    linear: Complex64[np.ndarray, "R+1 M J 3"]  # first-order motion of ring centres [m]
    linear_turn: Complex64[np.ndarray, "R M J 3"]


def sway(tree: Tree, wind: Wind, rng: np.random.Generator, *, num_frames: int = NUM_FRAMES, loop: bool = True) -> Sway:
    """Move a tree in the wind for `num_frames` frames at 24 fps."""
    gusts = gusts_of(wind, rng, loop=loop)
    clock = _clock(gusts, num_frames)
    levels: list[_Moving] = []
    shifts, turns, positions = [], [], []
    for depth, stems in enumerate(tree.stems):
        levels.append(_move(stems, levels[-1] if levels else None, gusts, clock, rng, still_root=depth == 0))
        shift, turn = _ring_motion(stems, levels, depth)
        shifts.append(shift)
        turns.append(turn)
        positions.append(stems.points[own_rings(stems)])
    for leaves in tree.leaves:
        shift, turn = _flutter(leaves, tree.stems[leaves.level], levels[leaves.level], gusts, clock, rng)
        shifts.append(shift)
        turns.append(turn)
        positions.append(leaves.base)
    return Sway(
        shift=np.concatenate(shifts, axis=1), turn=np.concatenate(turns, axis=1), position=np.concatenate(positions)
    )


def _clock(gusts: Gusts, num_frames: int) -> Complex64[np.ndarray, "J T"]:
    """2 e^{iωt} at the gusts' frequencies: Re(q @ clock) is the motion."""
    turn = 2j * np.pi * gusts.bins[:, None] * np.arange(num_frames) / NUM_FRAMES
    return (2 * np.exp(turn)).astype(np.complex64)


def _in_time(
    angle: Complex64[np.ndarray, "M J 3"], mean: Float32[np.ndarray, "M 3"], clock: Complex64[np.ndarray, "J T"]
) -> Float32[np.ndarray, "3 M T"]:
    """Deflection of each stem along x, y, z at each frame [rad]."""
    stacked = np.concatenate([angle.real, -angle.imag], axis=1).transpose(2, 0, 1)  # [3, M, 2J]
    turning = stacked @ np.concatenate([clock.real, clock.imag])
    return (turning + mean.T[:, :, None]).astype(np.float32)


def _move(
    stems: Stems,
    parent: _Moving | None,
    gusts: Gusts,
    clock: Complex64[np.ndarray, "J T"],
    rng: np.random.Generator,
    *,
    still_root: bool,
) -> _Moving:
    count, rings, num_frames = len(stems.points), stems.segments, clock.shape[1]
    num_bins = len(gusts.bins)
    own_bin = stem_bin(stems.length_m)
    base_radius = stems.radii[np.arange(count), stems.first]
    lean = lean_angle(stems.length_m, base_radius, gusts.wind.speed_m_s)
    share = _bending_share(stems, still_root=still_root)  # [M, R]

    place = np.zeros((rings + 1, 3, count, num_frames), np.float32)
    turn = np.zeros((rings, 4, count, num_frames), np.float32)
    linear = np.zeros((rings + 1, count, num_bins, 3), np.complex64)
    linear_turn = np.zeros((rings, count, num_bins, 3), np.complex64)
    current = np.zeros((4, count, num_frames), np.float32)
    current[0] = 1
    here = np.broadcast_to(stems.points[:, 0].T[:, :, None], (3, count, num_frames)).copy()
    current_linear = np.zeros((count, num_bins, 3), np.complex64)
    here_linear = np.zeros((count, num_bins, 3), np.complex64)
    phase = np.zeros((count, num_bins, 3), np.float32)
    angle = np.zeros((count, num_bins, 3), np.complex64)
    deflection = np.zeros((3, count, num_frames), np.float32)

    for ring in range(rings):
        born = np.flatnonzero(stems.first == ring)
        if len(born):
            source = stems.parent[born]
            if ring:
                here[:, born], current[:, born] = here[:, source], current[:, source]
                here_linear[born], current_linear[born] = here_linear[source], current_linear[source]
                inherited = phase[source]
            elif parent is not None:
                on = np.minimum(stems.parent_ring[born].astype(np.int32), len(parent.turn) - 1)
                along = (stems.parent_ring[born] - on).astype(np.float32)
                low, high = parent.place[on, :, source], parent.place[on + 1, :, source]  # [C, 3, T]
                here[:, born] = (low + along[:, None, None] * (high - low)).transpose(1, 0, 2)
                current[:, born] = parent.turn[on, :, source].transpose(1, 0, 2)
                base = parent.linear[on, source]
                here_linear[born] = base + along[:, None, None] * (parent.linear[on + 1, source] - base)
                current_linear[born] = parent.linear_turn[on, source]
                inherited = parent.phase[source]
            else:
                inherited = np.zeros((len(born), num_bins, 3), np.float32)
            phase[born] = inherited + _stray(gusts, len(born), rng)
            driven = phase[born] + gusts.phase - _delay(gusts, stems.points[born, ring])[:, :, None]
            base_angle = here_linear[born] @ gusts.axes.T / stems.length_m[born][:, None, None]
            reply = answer(gusts, lean[born], own_bin[born], driven, base_angle)
            angle[born] = reply @ gusts.axes
            mean = (lean[born][:, None] * gusts.axes[0]).astype(np.float32)
            deflection[:, born] = _in_time(angle[born], mean, clock)
        segment = stems.points[:, ring + 1] - stems.points[:, ring]  # [M, 3]
        along_axis = segment / np.maximum(np.linalg.norm(segment, axis=1, keepdims=True), 1e-9)
        place[ring], linear[ring] = here, here_linear
        bend = share[:, ring][None, :, None] * _cross(along_axis.T[:, :, None], deflection)
        current = product(current, turn_of(bend))
        current_linear = current_linear + share[:, ring][:, None, None] * np.cross(along_axis[:, None], angle)
        turn[ring], linear_turn[ring] = current, current_linear
        here = here + carried(current, segment.T[:, :, None])
        here_linear = here_linear + np.cross(current_linear, segment[:, None])
    place[rings], linear[rings] = here, here_linear
    return _Moving(place=place, turn=turn, phase=phase, linear=linear, linear_turn=linear_turn)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _bending_share(stems: Stems, *, still_root: bool) -> Float32[np.ndarray, "M R"]:
    """What part of a stem's whole bend each of its segments takes: Weber and Penn's (1 − z) / r."""
    ring = np.arange(stems.segments)
    own = ring >= stems.first[:, None]
    place = (ring - stems.first[:, None]) / (stems.segments + 1 - stems.first[:, None])
    share = np.where(own, (1 - place) / stems.radii[:, :-1], 0)
    if still_root:
        share[:, 0] = 0
    return (share / share.sum(axis=1, keepdims=True)).astype(np.float32)


def _stray(gusts: Gusts, count: int, rng: np.random.Generator) -> Float32[np.ndarray, "M J 3"]:
    spread = PHASE_SPREAD_RAD * gusts.bins[:, None]
    return (spread * rng.standard_normal((count, len(gusts.bins), 3), np.float32)).astype(np.float32)


def _delay(gusts: Gusts, base: Float32[np.ndarray, "M 3"]) -> Float32[np.ndarray, "M J"]:
    """Phase by which a gust comes later downwind: it travels with the wind [rad]."""
    seconds = base @ gusts.axes[0] / max(gusts.wind.speed_m_s, 1.0)
    return (2 * np.pi * gusts.bins * FPS / NUM_FRAMES * seconds[:, None]).astype(np.float32)


def _ring_motion(
    stems: Stems, levels: list[_Moving], depth: int
) -> tuple[Float32[np.ndarray, "T B 3"], Float32[np.ndarray, "T B 3 3"]]:
    """Motion of a level's nodes: a ring takes the mean turn of the segments that meet in it."""
    moving = levels[depth]
    turn = to_matrix(moving.turn.transpose(1, 0, 2, 3))  # [3, 3, R, M, T]
    at_ring = np.concatenate([turn[:, :, :1], (turn[:, :, 1:] + turn[:, :, :-1]) / 2, turn[:, :, -1:]], axis=2)
    born = stems.first[stems.first > 0]
    at_ring[:, :, born, stems.first > 0] = turn[:, :, born, stems.first > 0]
    own = own_rings(stems)
    shift = moving.place - stems.points.transpose(1, 2, 0)[:, :, :, None]  # [R+1, 3, M, T]
    shift = shift.transpose(3, 2, 0, 1)[:, own]
    return np.ascontiguousarray(shift), np.ascontiguousarray(at_ring.transpose(4, 3, 2, 0, 1)[:, own])


def _flutter(
    leaves: Leaves,
    stems: Stems,
    bearer: _Moving,
    gusts: Gusts,
    clock: Complex64[np.ndarray, "J T"],
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "T B 3"], Float32[np.ndarray, "T B 3 3"]]:
    """Motion of leaves: rigid cards, each an oscillator of its own length on the stem's segment."""
    on = np.minimum(leaves.ring.astype(np.int32), stems.segments - 1)
    along = (leaves.ring - on).astype(np.float32)[:, None, None]
    low, high = bearer.place[on, :, leaves.row], bearer.place[on + 1, :, leaves.row]  # [Q, 3, T]
    here = (low + along * (high - low)).transpose(1, 0, 2)
    drag = (gusts.wind.speed_m_s / REFERENCE_SPEED_M_S) ** DRAG_EXPONENT
    lean = np.full(len(leaves.base), MAX_LEAN_RAD * np.tanh(LEAF_LEAN_RAD * drag / MAX_LEAN_RAD))
    phase = bearer.phase[leaves.row] + _stray(gusts, len(lean), rng)
    driven = phase + gusts.phase - _delay(gusts, leaves.base)[:, :, None]
    own_bin = stem_bin(leaves.length_m)
    still = np.zeros((len(lean), len(gusts.bins), 3), np.complex64)
    angle = answer(gusts, lean, own_bin, driven, still) @ gusts.axes
    deflection = _in_time(angle, (lean[:, None] * gusts.axes[0]).astype(np.float32), clock)
    bend = _cross(leaves.axis.T[:, :, None], deflection)
    turn = product(bearer.turn[on, :, leaves.row].transpose(1, 0, 2), turn_of(bend))
    shift = here - leaves.base.T[:, :, None]
    return (
        np.ascontiguousarray(shift.transpose(2, 1, 0)),
        np.ascontiguousarray(to_matrix(turn).transpose(3, 2, 0, 1)),
    )


def node_spectrum(
    motion: Sway, num_frequencies: int = NUM_FREQUENCIES
) -> tuple[Complex64[np.ndarray, "K B 3"], Complex64[np.ndarray, "K B 3 3"]]:
    """Transform of the nodes' rigid motions: `num_frequencies` bins of shift and turn. A vertex's follows linearly."""
    frames, nodes = motion.shift.shape[:2]
    turning = -2j * np.pi * np.arange(num_frequencies)[:, None] * np.arange(frames) / frames
    transform = (np.exp(turning) / frames).astype(np.complex64)
    series = np.concatenate([motion.shift.reshape(frames, -1), motion.turn.reshape(frames, -1)], axis=1)
    both = np.concatenate([transform.real, transform.imag]) @ series  # [2K, 12 B]: one real product
    hat = both[:num_frequencies] + 1j * both[num_frequencies:]
    split = 3 * nodes
    return (
        hat[:, :split].reshape(num_frequencies, nodes, 3),
        hat[:, split:].reshape(num_frequencies, nodes, 3, 3),
    )


def vertex_spectrum(
    motion: Sway,
    vertices: Float32[np.ndarray, "N 3"],
    node: Int32[np.ndarray, " N"],
    num_frequencies: int = NUM_FREQUENCIES,
) -> Complex64[np.ndarray, "N K 3"]:
    """Spectrum of every vertex [m]; equal to that of its motion, without making the motion."""
    shift, turn = node_spectrum(motion, num_frequencies)
    offset = vertices - motion.position[node]
    out = np.empty((len(vertices), num_frequencies, 3), np.complex64)
    for k in range(num_frequencies):
        out[:, k] = shift[k, node] + np.einsum("nxy,ny->nx", turn[k, node], offset)
    return out
