"""Project forces on the tree to generalised forces per step; they are linear and additive.

Forces F_p [N] at points p give coordinate k the generalised force f_k = Σ_p conj(φ_k(p)) · F_p [J]. Each time step
gets the force's mean over it, so an impulse is independent of dt.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float32, Float64, Int32

from dynamictree.errors import InputError
from dynamictree.modal.step import State
from dynamictree.modal.system import ModalSystem
from dynamictree.voxel.grid import VoxelGrid

Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class CarriedPoint:
    """Point of the mesh that a drag by displacement fixes, and the bones that carry it."""

    point_m: Float32[np.ndarray, " 3"]
    bones: Int32[np.ndarray, " W"]  # bones of the rig
    weights: Float32[np.ndarray, " W"]


@dataclass(frozen=True, kw_only=True)
class Contact:
    """Voxels over which a force is distributed; the weights sum to 1, the first row is its target."""

    rows: Int32[np.ndarray, " P"]
    weights: Float64[np.ndarray, " P"]
    grip: CarriedPoint | None = None  # point that a drag by displacement fixes; None for the first voxel


@dataclass(frozen=True, kw_only=True)
class Impulse:
    """Impulse [N s], distributed evenly over its duration (0 means within one step)."""

    at: Contact
    impulse_n_s: Vector
    start_s: float = 0.0
    duration_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Drag:
    """Pull and release of a point, by a force or by the displacement to reach."""

    at: Contact
    force_n: Vector | None = None
    displacement_m: Vector | None = None
    start_s: float = 0.0
    duration_s: float | None = None  # None for a permanent load


@dataclass(frozen=True, kw_only=True)
class WindField:
    """Wind over the whole tree: samples of its velocity, evenly spaced over the duration."""

    velocity_m_s: Float64[np.ndarray, "S 3"]
    start_s: float = 0.0
    duration_s: float | None = None


Force = Impulse | Drag | WindField


def contact_at_voxel(grid: VoxelGrid, row: int) -> Contact:
    """Create a contact at one voxel, by its row in the spectrum.

    Raises:
        InputError: there is no such row.
    """
    if not 0 <= row < len(grid):
        raise InputError(f"voxel {row} does not exist; the spectrum has voxels 0 to {len(grid) - 1}")
    return Contact(rows=np.array([row], np.int32), weights=np.ones(1))


def contact_at_point(grid: VoxelGrid, point_m: Vector, *, radius_m: float = 0.0) -> Contact:
    """Create a contact at the voxel nearest to a point, or evenly at all voxels within a radius.

    Raises:
        InputError: the point is not finite, or no voxel is near.
    """
    reach_voxels = 3.0  # [voxels]; a point farther from all voxel centres is outside the tree
    if not (np.isfinite(point_m).all() and np.isfinite(radius_m) and radius_m >= 0):
        raise InputError(f"point_m {point_m} with radius_m {radius_m}; both must be finite, the radius not negative")
    distance = np.linalg.norm(grid.centres_m - np.asarray(point_m), axis=1)  # [V]
    nearest = int(np.argmin(distance))
    reach = max(radius_m, reach_voxels * grid.voxel_size_m)
    if distance[nearest] > reach:
        centre = [round(float(x), 3) for x in grid.centres_m[nearest]]
        raise InputError(
            f"point {list(point_m)} lies outside of the tree: the nearest voxel, {centre}, is "
            f"{distance[nearest]:.3g} m away, {reach:.3g} m is allowed; aim nearer or give a larger radius_m"
        )
    within = np.flatnonzero(distance <= radius_m)
    rows = np.concatenate([[nearest], within[within != nearest]]).astype(np.int32)
    return Contact(rows=rows, weights=np.full(len(rows), 1 / len(rows)))


def generalised_force(
    system: ModalSystem, force: Force, *, dt_s: float, num_frames: int
) -> Complex128[np.ndarray, "T M"]:
    """Compute the generalised force f_k, averaged over each step [J].

    Raises:
        InputError: a vector or a time is not finite, or a drag is impossible.
    """
    match force:
        case Impulse():
            vector = require_finite("impulse_n_s", force.impulse_n_s)
            rate = _impulse_rate(force, dt_s, num_frames)
            return np.asarray(rate[:, None] * modal_force(system, force.at, vector))
        case Drag():
            share = share_of_steps(force.start_s, force.duration_s, dt_s, num_frames)
            return np.asarray(share[:, None] * modal_force(system, force.at, drag_force_n(system, force)))
        case WindField():
            return _wind(system, force, dt_s, num_frames)


def modal_force(system: ModalSystem, at: Contact, vector_n: Float64[np.ndarray, " 3"]) -> Complex128[np.ndarray, " M"]:
    """Project a force at a contact to modal coordinates, Σ_p conj(φ_k(p)) · F_p [J]."""
    pushed: Complex128[np.ndarray, " M"] = _shape_at(system, at).conj() @ vector_n
    return pushed


def drag_force_n(system: ModalSystem, drag: Drag) -> Float64[np.ndarray, " 3"]:
    """Return the force of a drag [N]; for a displacement, the static force that reaches it.

    A point is compliant in some directions only (a branch bends, it does not stretch), so the compliance is inverted
    with Tikhonov regularization: the point moves the whole way along soft directions, and hardly along stiff ones.

    Raises:
        InputError: not exactly one of force and displacement is given, or the modes do not move the point.
    """
    stiff_share = 0.1  # relative compliance of a direction that is dragged half of the way
    if (drag.force_n is None) == (drag.displacement_m is None):
        raise InputError("a drag has either force_n or displacement_m; give exactly one of them")
    if drag.force_n is not None:
        return require_finite("force_n", drag.force_n)
    assert drag.displacement_m is not None
    wanted = require_finite("displacement_m", drag.displacement_m)
    tensor = compliance(system, drag.at)
    if np.trace(tensor) <= 0:
        raise InputError("the tree does not move at the point that is dragged; aim higher, or at a branch")
    softness, axes = np.linalg.eigh(tensor)
    damped = softness / (softness**2 + (stiff_share * softness[-1]) ** 2)  # [N/m]
    return np.asarray(axes @ (damped * (axes.T @ wanted)))


def compliance(system: ModalSystem, at: Contact) -> Float64[np.ndarray, "3 3"]:
    """Compute the static displacement per force at a contact, Σ_k Re(φ_k φ_kᴴ) / (m ω_k²) [m/N]."""
    shape = _shape_at(system, at)  # [M, 3]
    softness = (shape / system.stiffness[:, None]).T @ shape.conj()
    return np.asarray(softness.real)


def equilibrium(system: ModalSystem, generalised_n_m: Complex128[np.ndarray, "G M"]) -> State:
    """Return the state at rest under a permanent load, q_k = f_k / (m ω_k²)."""
    return State(q=generalised_n_m / system.stiffness, q_dot=np.zeros_like(generalised_n_m))


def davis_state(system: ModalSystem, force: Impulse | Drag, *, gain: float = 1.0) -> State:
    """Initial state of Davis et al. 2015, section 4.3: |z_k| = α|φ_k·d|, arg z_k = −arg(φ_k·d), −π/2 for an impulse.

    With z = q − i q̇/ω, a constant drag has q = z and no rate; an impulse has q = 0 and a rate. The state is not
    additive: d is a direction, and only the gain sets the strength. α = gain / max_k|φ_k·d|².

    Raises:
        InputError: the force has no direction, or no mode moves along it.
    """
    vector = force.impulse_n_s if isinstance(force, Impulse) else force.displacement_m or force.force_n
    assert vector is not None
    along = require_finite("direction", vector)
    length = float(np.linalg.norm(along))
    moved = _shape_at(system, force.at) @ (along / max(length, np.finfo(np.float64).tiny))  # φ·d, [M]
    largest = float(np.abs(moved).max())
    if largest == 0:
        raise InputError(f"nothing moves along {list(vector)} at the contact; choose another direction or point")
    z = gain / largest**2 * np.abs(moved) * np.exp(-1j * np.angle(moved))
    zero = np.zeros_like(z)
    if isinstance(force, Impulse):
        return State(q=zero[None], q_dot=(system.omega * z)[None])
    return State(q=z[None], q_dot=zero[None])


def _shape_at(system: ModalSystem, at: Contact) -> Complex128[np.ndarray, "M 3"]:
    return np.asarray(np.einsum("p,pmc->mc", at.weights, system.shapes[at.rows].astype(np.complex128)))


def _wind(system: ModalSystem, wind: WindField, dt_s: float, num_frames: int) -> Complex128[np.ndarray, "T M"]:
    """Compute the wind's drag ½ρ C A |v| v on every voxel, with A a quarter of its face, as for convex bodies."""
    drag_coefficient = 0.25  # measured: 0.2 to 0.4 for crowns in leaf at 10 m/s; half the surface or more is in the lee
    air_density_kg_m3 = 1.2
    velocity = np.asarray(wind.velocity_m_s, np.float64)
    if len(velocity) == 0:
        raise InputError("the wind has no samples; give at least one velocity")
    require_finite("wind_m_s", velocity.ravel())
    area = system.grid.voxel_size_m**2 / 4
    pressure = air_density_kg_m3 / 2 * drag_coefficient * area * np.linalg.norm(velocity, axis=1, keepdims=True)
    per_voxel_n = pressure * velocity  # [S, 3]
    share = share_of_steps(wind.start_s, wind.duration_s, dt_s, num_frames)
    times = (np.arange(num_frames) + 0.5) * dt_s - wind.start_s
    span = num_frames * dt_s - wind.start_s if wind.duration_s is None else wind.duration_s
    at_samples = np.linspace(0, max(span, dt_s), len(velocity))
    blowing = np.stack([np.interp(times, at_samples, axis) for axis in per_voxel_n.T], axis=1)  # [T, 3]
    everywhere = system.shapes.sum(axis=0, dtype=np.complex128)  # Σ_p φ_k(p), [M, 3]
    pushed: Complex128[np.ndarray, "T M"] = (share[:, None] * blowing) @ everywhere.conj().T
    return pushed


def _impulse_rate(force: Impulse, dt_s: float, num_frames: int) -> Float64[np.ndarray, " T"]:
    """Return the share of the impulse in each step, per second [1/s]."""
    if force.duration_s > 0:
        return share_of_steps(force.start_s, force.duration_s, dt_s, num_frames) / force.duration_s
    _check_times(force.start_s, force.duration_s)
    step = np.floor(force.start_s / dt_s + 1e-9)  # a start at a step's boundary belongs to the step that begins there
    rate: Float64[np.ndarray, " T"] = (np.arange(num_frames) == step) / dt_s
    return rate


def share_of_steps(start_s: float, duration_s: float | None, dt_s: float, num_frames: int) -> Float64[np.ndarray, " T"]:
    """Return the share of each step during which a force acts."""
    _check_times(start_s, duration_s)
    begin = np.arange(num_frames) * dt_s
    end_s = np.inf if duration_s is None else start_s + duration_s
    overlap = np.minimum(begin + dt_s, end_s) - np.maximum(begin, start_s)
    return np.asarray(np.clip(overlap / dt_s, 0, 1))


def _check_times(start_s: float, duration_s: float | None) -> None:
    if not np.isfinite(start_s) or not (duration_s is None or (np.isfinite(duration_s) and duration_s >= 0)):
        raise InputError(f"start_s {start_s}, duration_s {duration_s}: both must be finite, the duration not negative")


def require_finite(name: str, values: Vector | Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Convert values to an array, and check that they are finite.

    Raises:
        InputError: one of them is not finite.
    """
    vector = np.asarray(values, np.float64)
    if not np.isfinite(vector).all():
        raise InputError(f"{name} is {vector.tolist()}; every component must be finite")
    return vector
