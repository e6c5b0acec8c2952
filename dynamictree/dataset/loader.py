"""Trees as training wants them: turned, mirrored, scaled, shifted in time, and with the faults of real scans.

The mesh is changed and voxelised anew, so that voxels and normals are exact for what a user would bring. Each new voxel
takes the motion of the nearest voxel of the whole tree, so a fault never changes how the tree moves.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32
from scipy.spatial import cKDTree

from dynamictree.dataset.shards import StoredTree
from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels, voxelize


@dataclass(frozen=True, kw_only=True)
class Faults:
    """How bad a scan may be; a tree's own share of each is drawn between 0 and this. All off: `NO_FAULTS`."""

    missing_pieces: int = 4  # balls cut out of the crown
    missing_radius: float = 0.08  # of such a ball, of the height
    noise: float = 0.003  # standard deviation of the vertices, of the height
    decimation: float = 0.6  # share of the faces taken away by merging
    floaters: int = 20  # specks near the tree that belong to nothing


NO_FAULTS = Faults(missing_pieces=0, missing_radius=0.0, noise=0.0, decimation=0.0, floaters=0)


@dataclass(frozen=True, kw_only=True)
class Augmentation:
    """What may be changed, and how far."""

    turn: bool = True  # any angle about the vertical
    mirror: bool = True
    scale: float = 0.05  # a natural frequency goes with 1 / √size, so more would break the law between them
    time_shift: bool = True
    faults: Faults = NO_FAULTS
    fault_rate: float = 0.5  # share of the trees that get faults


@dataclass(frozen=True, kw_only=True)
class Example:
    """One tree as the network sees it."""

    voxels: SurfaceVoxels
    spectrum: SparseVoxelSpectrum
    wind: Wind
    species: str


def augmented(
    tree: StoredTree, rng: np.random.Generator, *, augmentation: Augmentation, resolution: int = 128
) -> Example:
    """One tree, changed as chance has it."""
    spectrum = tree.spectrum(resolution)
    angle = float(rng.uniform(0, 2 * np.pi)) if augmentation.turn else 0.0
    mirrored = bool(augmentation.mirror and rng.random() < 0.5)
    scale = float(rng.uniform(1 - augmentation.scale, 1 + augmentation.scale))
    matrix = placing(angle, mirrored=mirrored, scale=scale)
    mesh = TriangleMesh(vertices=tree.tensors["vertices"], faces=tree.tensors["faces"])
    if rng.random() < augmentation.fault_rate:
        mesh = with_faults(mesh, rng, augmentation.faults)
    if augmentation.time_shift:
        spectrum = time_shifted(spectrum, float(rng.uniform(0, spectrum.num_frames)))
    changed = mesh.with_vertices((mesh.vertices @ matrix.T).astype(np.float32))
    voxels = voxelize(changed if not mirrored else replace(changed, faces=changed.faces[:, ::-1]), resolution)
    moved = carried_over(spectrum, voxels.grid, matrix)
    wind = turned_wind(tree.wind, angle, mirrored=mirrored)
    return Example(voxels=voxels, spectrum=replace(moved, wind=wind), wind=wind, species=tree.species)


def placing(angle_rad: float, *, mirrored: bool, scale: float) -> Float32[np.ndarray, "3 3"]:
    """The linear map: mirror y, turn about the vertical, scale."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    matrix: Float32[np.ndarray, "3 3"] = (scale * turn @ np.diag([1, -1 if mirrored else 1, 1])).astype(np.float32)
    return matrix


def turned_wind(wind: Wind, angle_rad: float, *, mirrored: bool) -> Wind:
    """The wind that goes with a tree so placed."""
    direction = -wind.direction_deg if mirrored else wind.direction_deg
    return replace(wind, direction_deg=float((direction + np.rad2deg(angle_rad)) % 360))


def carried_over(
    spectrum: SparseVoxelSpectrum, grid: VoxelGrid, matrix: Float32[np.ndarray, "3 3"]
) -> SparseVoxelSpectrum:
    """Give each voxel of a new grid the motion of the nearest old voxel, vectors mapped by `matrix`."""
    there = (np.linalg.inv(matrix.astype(np.float64)) @ grid.centres_m.T).T
    _, nearest = cKDTree(spectrum.grid.centres_m).query(there)
    moved = (spectrum.coefficients[nearest] @ matrix.T).astype(np.complex64)
    return replace(spectrum, grid=grid, coefficients=moved)


def time_shifted(spectrum: SparseVoxelSpectrum, frames: float) -> SparseVoxelSpectrum:
    """The same loop, begun `frames` later: c_k e^{2πikτ/T}; exact for any τ.

    Where displacement is from the first frame, that frame becomes zero again: its displacement leaves c_0.

    Raises:
        InputError: the spectrum has the bin T / 2, which a shift between frames does not map to itself.
    """
    if 2 * (spectrum.num_frequencies - 1) >= spectrum.num_frames:
        raise InputError(
            f"{spectrum.num_frequencies} frequencies of {spectrum.num_frames} frames hold the bin T / 2; "
            f"keep at most {(spectrum.num_frames + 1) // 2} to shift in time"
        )
    bins = np.arange(spectrum.num_frequencies)
    turn = np.exp(2j * np.pi * bins * frames / spectrum.num_frames).astype(np.complex64)
    coefficients = spectrum.coefficients * turn[:, None]
    if spectrum.rest == "first-frame":
        first = coefficients[:, 0].real + 2 * coefficients[:, 1:].real.sum(axis=1)
        coefficients[:, 0] -= first
    return replace(spectrum, coefficients=coefficients)


def with_faults(mesh: TriangleMesh, rng: np.random.Generator, faults: Faults) -> TriangleMesh:
    """Spoil a mesh as scanners and reconstructions do: merge, cut, shake, and add specks."""
    height = mesh.height_m
    mesh = _decimated(mesh, float(rng.uniform(0, faults.decimation)))
    kept = mesh.faces[_kept_faces(mesh, rng, faults)]
    shake = rng.normal(0, 1, mesh.vertices.shape) * float(rng.uniform(0, faults.noise)) * height
    vertices = (mesh.vertices + shake).astype(np.float32)
    specks = int(rng.integers(0, faults.floaters + 1))
    around = vertices[rng.integers(0, len(vertices), specks)] + rng.normal(0, 0.05 * height, (specks, 3))
    corners = around[:, None] + rng.normal(0, 0.005 * height, (specks, 3, 3))
    corners[:, :, 2] = np.maximum(corners[:, :, 2], vertices[:, 2].min())
    faces = len(vertices) + np.arange(3 * specks).reshape(-1, 3)
    return TriangleMesh(
        vertices=np.concatenate([vertices, corners.reshape(-1, 3)]).astype(np.float32),
        faces=np.concatenate([kept, faces]).astype(np.int32),
    )


def _decimated(mesh: TriangleMesh, share: float) -> TriangleMesh:
    if share == 0:
        return mesh
    import fast_simplification

    vertices, faces = fast_simplification.simplify(mesh.vertices, mesh.faces, target_reduction=share)
    return TriangleMesh(vertices=vertices.astype(np.float32), faces=faces.astype(np.int32))


def _kept_faces(mesh: TriangleMesh, rng: np.random.Generator, faults: Faults) -> Bool[np.ndarray, " F"]:
    """All faces but those in balls about some of them; at least one stays."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    kept = np.ones(len(centres), bool)
    for _ in range(int(rng.integers(0, faults.missing_pieces + 1))):
        radius = float(rng.uniform(0, faults.missing_radius)) * mesh.height_m
        ball = np.linalg.norm(centres - centres[rng.integers(len(centres))], axis=1) < radius
        kept &= ~ball if (kept & ~ball).any() else True
    return kept
