"""Modal system: damped oscillators whose shapes are a spectrum's bins. Paper section 4; Davis et al. 2015, section 4.

A bin k >= 1 is a mode: its shape φ_k = w_k c_k (w_k = 2) is the complex amplitude of each voxel in the wind. Its
natural frequency is ω_k² = (2πk / P)² + (2πf_0)² - (2π / P)²; the lowest is given, or that of a real tree of this
height and foliage (`real_trees`). Each complex coordinate q_k is two real oscillators,

    m (q̈_k + 2 ζ_k ω_k q̇_k + ω_k² q_k) = Σ_p conj(φ_k(p)) · F_p,        u(p) = Re Σ_k φ_k(p) q_k.

φ is a length, so q is a pure number (q_k = exp(2πikt / P) is the wind's own sway) and m is in kg m². The tree's mass is
distributed evenly over its voxels, and contributes to a mode by that mode's share of the sway:

    m = mass_kg · mean_p Σ_k |φ_k(p)|² / 2.

So the response in metres to a force in newtons is invariant when the spectrum is scaled, and halves when the mass
doubles; for a single mode, m is the textbook's modal mass.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64, Int32

from dynamictree.errors import InputError
from dynamictree.modal.real_trees import free_omega, natural_damping, natural_frequency_hz
from dynamictree.requests import SwingParams
from dynamictree.spectrum import SparseVoxelSpectrum, bin_weights
from dynamictree.voxel.grid import VoxelGrid

MASS_KG_M3 = 0.2  # default green mass over height³: 25 kg at 5 m, 200 kg at 10 m, 1.6 t at 20 m


@dataclass(frozen=True, kw_only=True)
class ModalSystem:
    """Modal system with M = K - 1 modes on V voxels, created by `modal_system`."""

    grid: VoxelGrid
    tree: Int32[np.ndarray, " V"] | None = None  # number of the tree, from 0; None for one tree
    shapes: Complex64[np.ndarray, "V M 3"]  # φ [m], bins 1 to K - 1
    wind_omega: Float64[np.ndarray, " M"]  # frequencies of the bins [rad/s]
    omega: Float64[np.ndarray, " M"]  # natural frequencies [rad/s]
    damping_ratio: Float64[np.ndarray, " M"]  # ζ
    mass_kg: float
    sway_m2: float  # mean_p Σ_k |φ_k(p)|² / 2
    height_m: float
    foliage: float | None  # 0 for bare, 1 for in leaf; None if unknown

    @property
    def num_modes(self) -> int:
        """Number of modes M."""
        return len(self.omega)

    @property
    def modal_mass(self) -> float:
        """Modal mass: generalised force over generalised acceleration, m [kg m²]."""
        return self.mass_kg * self.sway_m2

    @property
    def stiffness(self) -> Float64[np.ndarray, " M"]:
        """Modal stiffness: generalised force over static coordinate, m ω² [N m]."""
        return self.modal_mass * self.omega**2


def modal_system(
    spectrum: SparseVoxelSpectrum,
    *,
    mass_kg: float | None = None,
    damping_ratio: float | Float64[np.ndarray, " M"] | None = None,
    frequency_hz: float | None = None,
    foliage: float | None = None,
) -> ModalSystem:
    """Create the oscillators of a spectrum.

    Args:
        spectrum: spectrum with K >= 2 bins; the first is the lean and no mode.
        mass_kg: moving mass [kg], distributed evenly over the voxels; by default `MASS_KG_M3` times height cubed.
        damping_ratio: ζ, one for all modes or one per mode; by default that of real trees.
        frequency_hz: lowest natural frequency; by default that of real trees. With 1 / P, all are those of the bins.
        foliage: 0 for bare, 1 for in leaf; by default the spectrum's.

    Raises:
        InputError: the spectrum has no motion, or mass, damping or frequency is not physical.
    """
    wind_omega = 2 * np.pi * spectrum.frequencies_hz[1:]  # [M]
    weights = bin_weights(spectrum.num_frequencies, spectrum.num_frames)
    shapes = np.ascontiguousarray((spectrum.coefficients * weights[:, None])[:, 1:])  # [V, M, 3]
    sway = float((np.abs(shapes) ** 2).sum(dtype=np.float64)) / (2 * len(shapes))
    if sway == 0:
        raise InputError("every coefficient above bin 0 is zero; a spectrum that does not move has no modes")
    height = spectrum.grid.height_m
    foliage = spectrum.foliage if foliage is None else foliage
    return ModalSystem(
        grid=spectrum.grid,
        tree=spectrum.tree,
        shapes=shapes,
        wind_omega=wind_omega,
        omega=_natural(wind_omega, frequency_hz, height, foliage),
        damping_ratio=_damping(damping_ratio, len(wind_omega), foliage),
        mass_kg=MASS_KG_M3 * height**3 if mass_kg is None else _mass(mass_kg),
        sway_m2=sway,
        height_m=height,
        foliage=foliage,
    )


def with_physics(
    system: ModalSystem,
    *,
    mass_kg: float | None = None,
    damping_ratio: float | Float64[np.ndarray, " M"] | None = None,
    frequency_hz: float | None = None,
    foliage: float | None = None,
) -> ModalSystem:
    """Change mass and foliage (None: unchanged), damping and lowest frequency (None: that of real trees).

    The shapes are shared with the given system.

    Raises:
        InputError: mass, damping or frequency is not physical.
    """
    foliage = system.foliage if foliage is None else foliage
    return replace(
        system,
        mass_kg=system.mass_kg if mass_kg is None else _mass(mass_kg),
        damping_ratio=_damping(damping_ratio, system.num_modes, foliage),
        omega=_natural(system.wind_omega, frequency_hz, system.height_m, foliage),
        foliage=foliage,
    )


def displacement(
    shapes: Complex64[np.ndarray, "N M 3"], q: Complex128[np.ndarray, "T M"]
) -> Float32[np.ndarray, "T N 3"]:
    """Compute each point's displacement at every frame, u = Re Σ_k φ_k q_k [m], by superposition."""
    num_points, num_modes, _ = shapes.shape
    # real part of a complex sum as one real product: [re q, -im q] · [re φ, im φ]
    stacked = np.concatenate([shapes.real, shapes.imag], axis=1).transpose(1, 0, 2)  # [2M, N, 3]
    coordinates = np.concatenate([q.real, -q.imag], axis=1).astype(np.float32)  # [T, 2M]
    moved = coordinates @ stacked.reshape(2 * num_modes, num_points * 3)
    return np.asarray(moved.reshape(len(q), num_points, 3))


def _mass(mass_kg: float) -> float:
    if not (np.isfinite(mass_kg) and mass_kg > 0):
        raise InputError(f"mass_kg is {mass_kg}; it must be positive and finite")
    return mass_kg


def _natural(
    wind_omega: Float64[np.ndarray, " M"], frequency_hz: float | None, height_m: float, foliage: float | None
) -> Float64[np.ndarray, " M"]:
    lowest = natural_frequency_hz(height_m, foliage) if frequency_hz is None else frequency_hz
    if not (np.isfinite(lowest) and lowest > 0):
        raise InputError(f"frequency_hz is {lowest}; it must be positive and finite")
    return free_omega(wind_omega, lowest)


def _damping(
    damping_ratio: float | Float64[np.ndarray, " M"] | None, num_modes: int, foliage: float | None
) -> Float64[np.ndarray, " M"]:
    zeta = np.asarray(natural_damping(foliage) if damping_ratio is None else damping_ratio, np.float64)
    if zeta.shape not in {(), (num_modes,)}:
        raise InputError(f"{zeta.shape} damping ratios for {num_modes} modes; give one, or one a mode")
    if not (np.isfinite(zeta).all() and (zeta >= 0).all()):
        raise InputError(f"damping_ratio is {damping_ratio}; it must be finite and not negative")
    return np.broadcast_to(zeta, num_modes)


def default_falloff_m(system: ModalSystem) -> float:
    """Return the default falloff of a push [m]: 15 % of the tree's height."""
    return 0.15 * (int(np.ptp(system.grid.coords[:, 2])) + 1) * system.grid.voxel_size_m


def chosen_falloff_m(system: ModalSystem, params: SwingParams) -> float | None:
    """Return the falloff of a request [m]; None if a push moves the whole tree."""
    return None if params.locality == "none" else params.falloff_m or default_falloff_m(system)
