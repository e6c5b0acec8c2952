"""Rig of a tree: bones, their rotation modes, and skinning weights of vertices and voxels."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Float32, Float64, Int32, Int64

from dynamictree.mesh import Surface, edges_of
from dynamictree.parallel import on_cores, single_thread
from dynamictree.rig.pose import GROUND, Skeleton, Weights, by_depth, carried, poses
from dynamictree.rig.surface_skeleton import FINENESS, surface_bones
from dynamictree.rig.turn_fit import fit_turns
from dynamictree.rig.turn_matrices import Target
from dynamictree.spectrum import SparseVoxelSpectrum, from_motion, iter_motion, quantise
from dynamictree.voxel.voxelize import surface_average, voxel_trees

BONES_PER_VOXEL = 4
"""Number of bones that carry a voxel, its strongest ones; as many as for an engine's vertex."""
_POINTS_AT_ONCE = 10_000  # points per pass, 12 MB of frames


@dataclass(frozen=True, kw_only=True)
class Rig:
    """B bones with K rotation modes each, which carry N vertices of a mesh and V voxels of a grid."""

    skeleton: Skeleton
    turns: Complex64[np.ndarray, "B K 3"]  # spectrum of θ [rad]: Re c_0 + 2 Re Σ c_k e^{2πik·phase}
    vertices: Weights
    voxels: Weights
    num_frames: int  # number of frames T of the spectrum, with frequencies up to T / 2

    def theta(self, phases: Float64[np.ndarray, " M"]) -> Iterator[Float32[np.ndarray, "B 3"]]:
        """Yield θ of each bone at phases of the loop [rad]; the phases are in periods."""
        return iter_motion(self.turns, phases, self.num_frames)

    def in_wind(
        self, theta: Float32[np.ndarray, "B 3"], turn: Float32[np.ndarray, "3 3"]
    ) -> Float32[np.ndarray, "B 3"]:
        """Rotate θ to another wind direction by a matrix about the vertical; each bone's end swings equally far."""
        direction = self.skeleton.directions
        along = (theta * direction).sum(axis=1, keepdims=True) * direction
        return np.asarray(np.cross(direction, np.cross(theta, direction) @ turn.T) + along, np.float32)

    def loop(
        self, points: Float32[np.ndarray, "n 3"], weights: Weights, num_frequencies: int | None = None
    ) -> Complex64[np.ndarray, "n L 3"]:
        """Compute the spectrum over one loop of points that the bones carry [m]; by default with K frequencies.

        Rotations move points along arcs, so some of the motion has frequencies above the K.
        """
        stance = poses(self.skeleton, np.stack(list(self.theta(np.arange(self.num_frames) / self.num_frames))))
        count = num_frequencies or self.turns.shape[1]
        result = np.empty((len(points), count, 3), np.complex64)
        for start in range(0, len(points), _POINTS_AT_ONCE):
            some = slice(start, start + _POINTS_AT_ONCE)
            moment = partial(carried, self.skeleton, stance, points=points[some], weights=weights[some])
            result[some] = from_motion(np.stack(on_cores(moment, range(self.num_frames))), count)
        return result

    def displacement(
        self, theta: Float32[np.ndarray, "B 3"], points: Float32[np.ndarray, "n 3"], weights: Weights
    ) -> Float32[np.ndarray, "n 3"]:
        """Compute the displacement of points that the bones carry, for given θ [m]."""
        return carried(self.skeleton, poses(self.skeleton, theta[None]), 0, points, weights)

    def levers_m(self, points: Float32[np.ndarray, "N 3"]) -> Float64[np.ndarray, " B"]:
        """Return each bone's reach, or its farthest vertex's distance, times the root of the number of bones on it."""
        skeleton, rows = self.skeleton, self.vertices.rows.T
        reach, count = np.linalg.norm(skeleton.reach_m, axis=1).astype(np.float64), np.ones(len(skeleton))
        np.maximum.at(reach, rows, np.linalg.norm(points - skeleton.foot_m[rows[0]], axis=1))
        for level in reversed(skeleton.levels):
            np.add.at(count, skeleton.above[level], count[level])
        return np.asarray(reach * np.sqrt(count))


def rig_of(mesh: Surface, spectrum: SparseVoxelSpectrum, report: Callable[[float], None] = lambda done: None) -> Rig:
    """Find the bones of a mesh and fit their rotations to a spectrum; `report` gets the completed share.

    Each of several trees has its own bones, and the voxels in which it has most of the surface.

    Raises:
        InputError: a voxel of the grid contains no surface of the mesh.
    """
    if mesh.face_tree is None:
        return _rig_of_tree(mesh, spectrum, report)
    moving = mesh.moving_part
    assert moving.face_tree is not None
    tree_of_voxel = voxel_trees(moving, spectrum.grid)
    every = []
    numbers = np.unique(tree_of_voxel[tree_of_voxel >= 0])
    for before, number in enumerate(numbers):
        report(before / len(numbers))
        rows = np.flatnonzero(tree_of_voxel == number)
        vertices, corner = np.unique(moving.faces[moving.face_tree == number], return_inverse=True)
        alone = Surface(vertices=moving.vertices[vertices], faces=corner.reshape(-1, 3).astype(np.int32))
        grid = replace(spectrum.grid, coords=spectrum.grid.coords[rows])
        own = replace(spectrum, grid=grid, coefficients=spectrum.coefficients[rows], tree=None)
        every.append((vertices, rows, rig_of(alone, own)))
    return _merge_rigs(every, mesh.num_vertices, len(spectrum.grid))


def quantise_shares(shares: Float64[np.ndarray, "n W"]) -> Float32[np.ndarray, "n W"]:
    """Round shares to steps of 1/255 that sum to 1; the first share takes the rounding error."""
    whole = np.rint(255 * shares / shares.sum(axis=1, keepdims=True))
    whole[:, 0] += 255 - whole.sum(axis=1)
    return np.asarray(whole / 255, np.float32)


def _rig_of_tree(mesh: Surface, spectrum: SparseVoxelSpectrum, report: Callable[[float], None]) -> Rig:
    moving, num_frames = mesh.moving_part, spectrum.num_frames
    bones = surface_bones(mesh, spectrum.grid)
    mean = surface_average(moving, spectrum.grid).astype(np.float64)
    target = Target(
        points=mesh.vertices,
        edges=edges_of(moving.faces),
        mean=mean,
        coefficients=spectrum.coefficients,
        num_frames=num_frames,
        voxel_m=float(np.ptp(mesh.vertices[np.unique(moving.faces)], axis=0).max()) / FINENESS,
    )
    with single_thread():  # the products are too small for several BLAS threads
        steps, step_rad = quantise(fit_turns(bones.skeleton, bones.vertices, target, report))
    parts = steps * step_rad[:, None, None]  # the file's rounded values, so that its readers show the same positions
    turns = parts[..., 0] + 1j * parts[..., 1]
    voxels = _strongest(mean, bones.vertices, len(bones.skeleton))
    return Rig(skeleton=bones.skeleton, turns=turns, vertices=bones.vertices, voxels=voxels, num_frames=num_frames)


def _strongest(mean: scipy.sparse.csr_array, vertices: Weights, num_bones: int) -> Weights:
    """Return the bones that carry most of the surface in each voxel."""
    num_vertices, width = vertices.rows.shape
    ends = width * np.arange(num_vertices + 1)
    carries = scipy.sparse.csr_array(
        (vertices.shares.ravel(), vertices.rows.ravel(), ends), shape=(num_vertices, num_bones)
    )
    shares = (mean @ carries).tocsr()
    shares.sum_duplicates()
    row = np.repeat(np.arange(shares.shape[0]), np.diff(shares.indptr))
    order = np.lexsort((-shares.data, row))
    rank = np.arange(len(row)) - shares.indptr[row]
    remaining = rank < BONES_PER_VOXEL
    rows = np.zeros((shares.shape[0], BONES_PER_VOXEL), np.int32)
    strongest = np.zeros(rows.shape)
    rows[row[remaining], rank[remaining]] = shares.indices[order][remaining]
    strongest[row[remaining], rank[remaining]] = shares.data[order][remaining]
    return Weights(rows=rows, shares=quantise_shares(strongest))


def _merge_rigs(
    every: Sequence[tuple[Int32[np.ndarray, " _"], Int64[np.ndarray, " _"], Rig]], num_vertices: int, num_voxels: int
) -> Rig:
    """Merge rigs, each with its rows of vertices and voxels, on one ground; points of no rig stand still."""
    bones = np.cumsum([1, *(len(rig.skeleton) - 1 for _, _, rig in every)])
    ground = every[0][2]

    def moved(rows: np.ndarray, first: int) -> np.ndarray:
        return np.where(rows <= GROUND, rows, rows + first - 1)

    parent = [ground.skeleton.parent[:1]]
    vertices, voxels = _on_ground(num_vertices, 2), _on_ground(num_voxels, BONES_PER_VOXEL)
    for first, (own, grid_rows, rig) in zip(bones.tolist(), every, strict=False):
        parent.append(moved(rig.skeleton.parent[1:], first))
        for all_of_them, some, weights in ((vertices, own, rig.vertices), (voxels, grid_rows, rig.voxels)):
            all_of_them.rows[some], all_of_them.shares[some] = moved(weights.rows, first), weights.shares
    rigs = [rig for _, _, rig in every]
    skeleton, order = by_depth(
        Skeleton(
            parent=np.concatenate(parent),
            foot_m=_joined(ground.skeleton.foot_m, [rig.skeleton.foot_m for rig in rigs]),
            reach_m=_joined(ground.skeleton.reach_m, [rig.skeleton.reach_m for rig in rigs]),
            in_surface=_joined(ground.skeleton.in_surface, [rig.skeleton.in_surface for rig in rigs]),
        )
    )
    number = np.argsort(order).astype(np.int32)
    return Rig(
        skeleton=skeleton,
        turns=_joined(ground.turns, [rig.turns for rig in rigs])[order],
        vertices=replace(vertices, rows=number[vertices.rows]),
        voxels=replace(voxels, rows=number[voxels.rows]),
        num_frames=ground.num_frames,
    )


def _joined(ground: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate([ground[:1], *(part[1:] for part in parts)])


def _on_ground(count: int, width: int) -> Weights:
    shares = np.zeros((count, width), np.float32)
    shares[:, 0] = 1
    return Weights(rows=np.full((count, width), GROUND, np.int32), shares=shares)
