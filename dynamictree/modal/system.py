"""Damped oscillators whose shapes are a spectrum's bins. Paper section 3.4; Davis et al. 2015, section 4.

A bin k >= 1 is a mode: its shape φ_k = w_k c_k (w_k = 2) is the complex amplitude with which the wind moved each voxel,
its natural frequency ω_k = 2πk / P. With one complex coordinate q_k, that is two real oscillators,

    m (q̈_k + 2 ζ_k ω_k q̇_k + ω_k² q_k) = Σ_p conj(φ_k(p)) · F_p,        u(p) = Re Σ_k φ_k(p) q_k.

φ is a length, so q is a pure number (q_k = exp(iω_k t) is the wind's own sway) and m is in kg m². The tree's mass is
spread evenly over its voxels, and takes part in a mode by that mode's share of the sway:

    m = mass_kg · mean_p Σ_k |φ_k(p)|² / 2.

So the answer in metres to a force in newtons does not change when the spectrum is scaled, halves when the mass doubles,
and for a single mode m is the modal mass of the textbook.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64

from dynamictree.errors import InputError
from dynamictree.spectrum import SparseVoxelSpectrum, bin_weights
from dynamictree.voxel.grid import VoxelGrid

MASS_KG = 100.0  # the moving part of a tree of some 8 m: its crown
DAMPING_RATIO = 0.05  # trees in leaf measure 0.02 to 0.1


@dataclass(frozen=True, kw_only=True)
class ModalSystem:
    """M = K - 1 modes on V voxels; complete when built, by `modal_system`."""

    grid: VoxelGrid
    shapes: Complex64[np.ndarray, "V M 3"]  # φ [m], bins 1 to K - 1
    omega: Float64[np.ndarray, " M"]  # [rad/s]
    damping_ratio: Float64[np.ndarray, " M"]  # ζ
    modal_mass: float  # m [kg m²]

    @property
    def num_modes(self) -> int:
        """M."""
        return len(self.omega)

    @property
    def stiffness(self) -> Float64[np.ndarray, " M"]:
        """Generalised force over coordinate at rest, m ω² [N m]."""
        return self.modal_mass * self.omega**2


def modal_system(
    spectrum: SparseVoxelSpectrum,
    *,
    mass_kg: float = MASS_KG,
    damping_ratio: float | Float64[np.ndarray, " M"] = DAMPING_RATIO,
) -> ModalSystem:
    """Read a spectrum as oscillators.

    Args:
        spectrum: K >= 2 bins; the first is the lean and no mode.
        mass_kg: mass that moves [kg], spread evenly over the voxels.
        damping_ratio: ζ, one for all modes or one a mode (see `rayleigh_damping`).

    Raises:
        InputError: the spectrum does not move, or mass or damping is not a physical one.
    """
    if not (np.isfinite(mass_kg) and mass_kg > 0):
        raise InputError(f"mass_kg is {mass_kg}; it must be positive and finite")
    omega = 2 * np.pi * spectrum.frequencies_hz[1:]  # [M]
    zeta = np.asarray(damping_ratio, np.float64)
    if zeta.shape not in {(), omega.shape}:
        raise InputError(f"{zeta.shape} damping ratios for {len(omega)} modes; give one, or one a mode")
    zeta = np.broadcast_to(zeta, omega.shape)
    if not (np.isfinite(zeta).all() and (zeta >= 0).all()):
        raise InputError(f"damping_ratio is {damping_ratio}; it must be finite and not negative")
    weights = bin_weights(spectrum.num_frequencies, spectrum.num_frames)
    shapes = np.ascontiguousarray((spectrum.coefficients * weights[:, None])[:, 1:])  # [V, M, 3]
    power = float((np.abs(shapes) ** 2).sum(dtype=np.float64)) / (2 * len(shapes))  # mean_p Σ_k |φ|² / 2 [m²]
    if power == 0:
        raise InputError("every coefficient above bin 0 is zero; a spectrum that does not move has no modes")
    return ModalSystem(grid=spectrum.grid, shapes=shapes, omega=omega, damping_ratio=zeta, modal_mass=mass_kg * power)


def rayleigh_damping(omega: Float64[np.ndarray, " M"], *, alpha: float, beta: float) -> Float64[np.ndarray, " M"]:
    """ζ of each mode where the damping is α times the mass [1/s] plus β times the stiffness [s]."""
    ratio: Float64[np.ndarray, " M"] = alpha / (2 * omega) + beta * omega / 2
    return ratio


def displacement(
    shapes: Complex64[np.ndarray, "N M 3"], q: Complex128[np.ndarray, "T M"]
) -> Float32[np.ndarray, "T N 3"]:
    """Where each point stands at every frame, u = Re Σ_k φ_k q_k [m]: plain superposition."""
    num_points, num_modes, _ = shapes.shape
    # real part of a complex sum as one real product: [re q, -im q] · [re φ, im φ]
    stacked = np.concatenate([shapes.real, shapes.imag], axis=1).transpose(1, 0, 2)  # [2M, N, 3]
    coordinates = np.concatenate([q.real, -q.imag], axis=1).astype(np.float32)  # [T, 2M]
    moved = coordinates @ stacked.reshape(2 * num_modes, num_points * 3)
    return np.asarray(moved.reshape(len(q), num_points, 3))
