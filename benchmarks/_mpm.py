"""A short material point method of our own, as the rival in timings: MLS-MPM (Hu et al. 2018) on both cores.

PhysGaussian's settings: a grid of 50³ over 2 units, substeps of 1e-4 s, E = 2e6, ν = 0.4, ρ = 200. Quadratic weights,
APIC transfer, neo-Hookean stress (no SVD: cheaper than PhysGaussian's corotated one, to the rival's advantage).
Particles are sorted by cell. Each core scatters into its own grid, and the grids are summed, without atomics.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np

GRID = 50
SIZE = 2.0  # side of the grid's cube, in PhysGaussian's units
DT_S = 1e-4
YOUNG = 2e6
POISSON = 0.4
DENSITY = 200.0
SUBSTEPS_PER_FRAME = 400  # ficus: a frame of 4e-2 s
NUM_CORES = 2


@dataclass
class Particles:
    """State of all particles, in the order of their cells; changed in place."""

    position: np.ndarray  # [P, 3]
    velocity: np.ndarray  # [P, 3]
    affine: np.ndarray  # [P, 3, 3]
    deformation: np.ndarray  # [P, 3, 3]
    volume: np.ndarray  # [P]


def particles_at(points: np.ndarray, *, filled: float = 0.8) -> Particles:
    """Place particles at rest, scaled into the middle of the grid; the foot stands on the fixed floor."""
    low, high = points.min(axis=0), points.max(axis=0)
    scale = filled * SIZE / float((high - low).max())
    placed = (points - (low + high) / 2) * scale + SIZE / 2
    cell = (placed * (GRID / SIZE)).astype(np.int64)
    order = np.argsort((cell[:, 0] * GRID + cell[:, 1]) * GRID + cell[:, 2], kind="stable")
    count = np.unique(cell, axis=0, return_counts=True)[1]
    spacing = (SIZE / GRID) ** 3 / count.mean()
    shape = (len(points), 3, 3)
    return Particles(
        position=placed[order].astype(np.float32),
        velocity=np.zeros((len(points), 3), np.float32),
        affine=np.zeros(shape, np.float32),
        deformation=np.broadcast_to(np.eye(3, dtype=np.float32), shape).copy(),
        volume=np.full(len(points), spacing, np.float32),
    )


def advance(particles: Particles, *, num_substeps: int, gravity: float = 0.0, floor: float = 0.0) -> None:
    """Advance all particles; nodes below `floor` are fixed."""
    lam = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    mu = YOUNG / (2 * (1 + POISSON))
    p = particles
    grids = np.zeros((NUM_CORES, GRID**3, 4), np.float32)
    fixed_nodes = int(floor / SIZE * GRID)
    stiffness = (np.float32(lam), np.float32(mu))
    with ThreadPoolExecutor(NUM_CORES) as pool:

        def on_all_cores(kernel: Callable[..., None], *arguments: object) -> None:
            list(pool.map(lambda core: kernel(core, *arguments), range(NUM_CORES)))

        for _ in range(num_substeps):
            on_all_cores(_scatter, p.position, p.velocity, p.affine, p.deformation, p.volume, *stiffness, grids)
            on_all_cores(_update, grids, np.float32(gravity), fixed_nodes)
            on_all_cores(_gather, p.position, p.velocity, p.affine, p.deformation, grids[0])


@numba.njit(nogil=True, fastmath=True, cache=True)
def _scatter(core, position, velocity, affine, deformation, volume, lam, mu, grids):
    inverse = np.float32(GRID / SIZE)
    cell = np.float32(SIZE / GRID)
    stress_scale = np.float32(4 * DT_S) * inverse * inverse
    num_particles = len(position)
    grid = grids[core]
    grid[:] = 0
    w = np.empty((3, 3), np.float32)
    a = np.empty((3, 3), np.float32)
    for p in range(core * num_particles // NUM_CORES, (core + 1) * num_particles // NUM_CORES):
        f = deformation[p]
        f00, f01, f02 = f[0, 0], f[0, 1], f[0, 2]
        f10, f11, f12 = f[1, 0], f[1, 1], f[1, 2]
        f20, f21, f22 = f[2, 0], f[2, 1], f[2, 2]
        jacobian = f00 * (f11 * f22 - f12 * f21) - f01 * (f10 * f22 - f12 * f20) + f02 * (f10 * f21 - f11 * f20)
        # Kirchhoff stress of a neo-Hookean material: μ (F Fᵀ - I) + λ ln J I
        pressure = lam * np.log(max(jacobian, np.float32(1e-3))) - mu
        mass = volume[p] * np.float32(DENSITY)
        s = -stress_scale * volume[p]
        c = affine[p]
        a[0, 0] = s * (mu * (f00 * f00 + f01 * f01 + f02 * f02) + pressure) + mass * c[0, 0]
        a[1, 1] = s * (mu * (f10 * f10 + f11 * f11 + f12 * f12) + pressure) + mass * c[1, 1]
        a[2, 2] = s * (mu * (f20 * f20 + f21 * f21 + f22 * f22) + pressure) + mass * c[2, 2]
        t01 = s * mu * (f00 * f10 + f01 * f11 + f02 * f12)
        t02 = s * mu * (f00 * f20 + f01 * f21 + f02 * f22)
        t12 = s * mu * (f10 * f20 + f11 * f21 + f12 * f22)
        a[0, 1], a[1, 0] = t01 + mass * c[0, 1], t01 + mass * c[1, 0]
        a[0, 2], a[2, 0] = t02 + mass * c[0, 2], t02 + mass * c[2, 0]
        a[1, 2], a[2, 1] = t12 + mass * c[1, 2], t12 + mass * c[2, 1]
        x, y, z = position[p, 0] * inverse, position[p, 1] * inverse, position[p, 2] * inverse
        bx, by, bz = int(x - np.float32(0.5)), int(y - np.float32(0.5)), int(z - np.float32(0.5))
        fx, fy, fz = x - bx, y - by, z - bz
        _weights(fx, fy, fz, w)
        mx, my, mz = mass * velocity[p, 0], mass * velocity[p, 1], mass * velocity[p, 2]
        for i in range(3):
            dx = (i - fx) * cell
            for j in range(3):
                dy = (j - fy) * cell
                wij = w[0, i] * w[1, j]
                row = ((bx + i) * GRID + by + j) * GRID + bz
                px = mx + a[0, 0] * dx + a[0, 1] * dy
                py = my + a[1, 0] * dx + a[1, 1] * dy
                pz = mz + a[2, 0] * dx + a[2, 1] * dy
                for k in range(3):
                    dz = (k - fz) * cell
                    weight = wij * w[2, k]
                    grid[row + k, 0] += weight * (px + a[0, 2] * dz)
                    grid[row + k, 1] += weight * (py + a[1, 2] * dz)
                    grid[row + k, 2] += weight * (pz + a[2, 2] * dz)
                    grid[row + k, 3] += weight * mass


@numba.njit(nogil=True, fastmath=True, cache=True)
def _update(this, grids, gravity, fixed_nodes):
    """Sum the cores' grids into the first and convert momentum to velocity. Each core processes a share of the rows."""
    for row in range(this * GRID**3 // NUM_CORES, (this + 1) * GRID**3 // NUM_CORES):
        mass = np.float32(0)
        for core in range(NUM_CORES):
            mass += grids[core, row, 3]
        if mass <= 0:
            continue
        for c in range(3):
            total = np.float32(0)
            for core in range(NUM_CORES):
                total += grids[core, row, c]
            grids[0, row, c] = total / mass
        grids[0, row, 2] += np.float32(DT_S) * gravity
        if row % GRID < fixed_nodes:
            grids[0, row, :3] = 0


@numba.njit(nogil=True, fastmath=True, cache=True)
def _gather(core, position, velocity, affine, deformation, grid):
    inverse = np.float32(GRID / SIZE)
    num_particles = len(position)
    w = np.empty((3, 3), np.float32)
    b = np.empty((3, 3), np.float32)
    f = np.empty((3, 3), np.float32)
    for p in range(core * num_particles // NUM_CORES, (core + 1) * num_particles // NUM_CORES):
        x, y, z = position[p, 0] * inverse, position[p, 1] * inverse, position[p, 2] * inverse
        bx, by, bz = int(x - np.float32(0.5)), int(y - np.float32(0.5)), int(z - np.float32(0.5))
        fx, fy, fz = x - bx, y - by, z - bz
        _weights(fx, fy, fz, w)
        vx = vy = vz = np.float32(0)
        b[:] = 0
        for i in range(3):
            dx = i - fx
            for j in range(3):
                dy = j - fy
                wij = w[0, i] * w[1, j]
                row = ((bx + i) * GRID + by + j) * GRID + bz
                sx = sy = sz = np.float32(0)
                for k in range(3):
                    dz = k - fz
                    weight = wij * w[2, k]
                    gx, gy, gz = weight * grid[row + k, 0], weight * grid[row + k, 1], weight * grid[row + k, 2]
                    sx, sy, sz = sx + gx, sy + gy, sz + gz
                    b[0, 2] += gx * dz
                    b[1, 2] += gy * dz
                    b[2, 2] += gz * dz
                vx, vy, vz = vx + sx, vy + sy, vz + sz
                b[0, 0] += sx * dx
                b[1, 0] += sy * dx
                b[2, 0] += sz * dx
                b[0, 1] += sx * dy
                b[1, 1] += sy * dy
                b[2, 1] += sz * dy
        old = deformation[p]
        scale = 4 * inverse  # C = 4 / h² Σ w v (x_i - x_p)ᵀ; offsets above are in cells
        for i in range(3):
            for j in range(3):
                b[i, j] *= scale
                affine[p, i, j] = b[i, j]
        for i in range(3):
            for j in range(3):
                total = old[i, j]
                for k in range(3):
                    total += np.float32(DT_S) * b[i, k] * old[k, j]
                f[i, j] = total
        for i in range(3):
            for j in range(3):
                old[i, j] = f[i, j]
        velocity[p, 0], velocity[p, 1], velocity[p, 2] = vx, vy, vz
        position[p, 0] += np.float32(DT_S) * vx
        position[p, 1] += np.float32(DT_S) * vy
        position[p, 2] += np.float32(DT_S) * vz


@numba.njit(fastmath=True, cache=True)
def _weights(fx, fy, fz, w):
    """Compute quadratic B-spline weights of the three nodes on each axis, at f in [0.5, 1.5]."""
    half = np.float32(0.5)
    for axis in range(3):
        f = fx if axis == 0 else (fy if axis == 1 else fz)
        w[axis, 0] = half * (np.float32(1.5) - f) ** 2
        w[axis, 1] = np.float32(0.75) - (f - np.float32(1)) ** 2
        w[axis, 2] = half * (f - half) ** 2
