"""Small trees of voxels with known branches."""

import numpy as np

from dynamictree.mesh import TriangleMesh, join_meshes
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.system import modal_system
from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid

VOXEL_M = 0.1


def fork(num_frequencies: int = 8, *, fineness: int = 1) -> tuple[SparseVoxelSpectrum, dict[str, np.ndarray]]:
    """A stem of 2 m with a branch of 1.5 m to either side, three voxels wide; branches sway out of step.

    With it the rows along the middle of each part, from the root outward. Voxels are `VOXEL_M / fineness` wide.
    """
    voxel_m, middle_x, top = VOXEL_M / fineness, 25 * fineness, 20 * fineness - 1
    stem = np.array([(middle_x, 26, z) for z in range(top + 1)], np.int32)
    outward = range(1, 15 * fineness + 1)
    right = np.array([(middle_x + x, 26, top + x // 2) for x in outward], np.int32)
    left = np.array([(middle_x - x, 26, top + x // 2) for x in outward], np.int32)
    middle = np.concatenate([stem, right, left])
    coords = np.concatenate([middle + np.array([0, y, 0]) for y in (-1, 0, 1)]).astype(np.int32)
    resolution = 64 * fineness
    grid = VoxelGrid.from_coords(coords, origin_m=(0.0, 0.0, 0.0), voxel_size_m=voxel_m, resolution=resolution)
    parts = {"stem": grid.rows_of(stem), "right": grid.rows_of(right), "left": grid.rows_of(left)}

    rng = np.random.default_rng(3)
    along_y = np.array([0.0, 1.0, 0.0])
    out = (grid.coords[:, 0] - middle_x) * voxel_m  # distance from the stem, to the right
    height = np.where(out == 0, grid.coords[:, 2] + 1, top + 1) * voxel_m
    coefficients = np.zeros((len(grid), num_frequencies, 3), np.complex128)
    for k in range(1, num_frequencies):
        lean, *flutter = np.exp(2j * np.pi * rng.random(3)) * [0.02 / k, 0.04, 0.04]
        sway = lean * height**2 + np.where(out > 0, flutter[0], flutter[1]) * out**2
        coefficients[:, k] = sway[:, None] * along_y
    return SparseVoxelSpectrum(grid=grid, coefficients=coefficients.astype(np.complex64)), parts


def rigged_fork(fineness: int = 1) -> tuple[InteractiveTree, TriangleMesh, dict[str, np.ndarray]]:
    """The fork as a tree of ribbons, one through the voxels of each part, which may be pulled."""
    spectrum, parts = fork(fineness=fineness)
    half = np.array([0, 1.45 * spectrum.grid.voxel_size_m, 0])
    ribbons = []
    for name, rows in parts.items():
        foot = parts["stem"][:0] if name == "stem" else parts["stem"][-1:]  # where it hangs
        middle = spectrum.grid.centres_m[np.concatenate([foot, rows])].astype(np.float64)
        vertices = np.stack([middle - half, middle + half], axis=1).reshape(-1, 3)
        first = 2 * np.arange(len(middle) - 1)[:, None]
        faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([1, 3, 2])])
        ribbons.append(TriangleMesh(vertices=vertices.astype(np.float32), faces=faces.astype(np.int32)))
    mesh = join_meshes(ribbons)
    system = modal_system(spectrum, mass_kg=30.0, damping_ratio=0.05)
    return InteractiveTree(system, rig_of(mesh, spectrum), mesh), mesh, parts
