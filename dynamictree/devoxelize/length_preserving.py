"""Length-preserving devoxelization: removes the stretch of edges from a motion, and preserves its bending.

Neighbouring voxels of a generated spectrum differ by noise, and a short edge between them would stretch. This minimises
over the vertices' motion x(t), with x⁰(t) the motion before, the mean over the loop of

    Σ_i w_i |x_i - x⁰_i|²  +  Σ_ij (μ max(1, h / l_ij)² (|e_ij + x_i - x_j| - l_ij)² + ν (h / l_ij)² |x_i - x_j|²)

with h the edge of a voxel, e_ij an edge at rest and l_ij its length: elongation costs much, turning little. Small
motions are fitted to the same relative accuracy as large ones: w_i is the mean size of the motion over that of x⁰_i.
Solved by Gauss-Newton steps: first for the mean pose alone (k = 0), then for all frequencies, linearised along the
edges of the mean pose.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Float32, Int32

from dynamictree.devoxelize.attachment import Attachments
from dynamictree.devoxelize.conjugate_gradients import conjugate_gradients
from dynamictree.devoxelize.interpolation import VoxelInterpolation
from dynamictree.devoxelize.limit import limited
from dynamictree.devoxelize.smooth import smooth
from dynamictree.devoxelize.surface_fit import LINK
from dynamictree.mesh import Surface, edges_of, weld
from dynamictree.parallel import num_cores, single_thread
from dynamictree.spectrum import bin_weights, synthesis
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import voxel_trees

ELONGATION = 30.0
"""μ, see docs/decisions/core.md."""
TURNING = 0.1
"""ν: prevents short edges from spinning."""

_LARGEST_WEIGHT = 100.0
_ROUNDS = 3  # Gauss-Newton steps
_MEAN_SHARE = 0.3  # of the time goes to the mean pose
_STEP_LENGTHS = (1.0, 0.5)  # tried in this order: the harmonics of large rotations make whole steps overshoot
_CG_STEPS = 20
_CG_VERTICES = 40_000  # larger meshes get fewer steps: their edges are shorter, and stretch is more local
_MIN_CG_STEPS = 8
_SHORTEST_EDGE = 0.01  # in voxels; shorter edges are no stiffer
_FRAMES_PER_BIN = 4  # elongation has twice the motion's bandwidth
_EDGES_AT_ONCE = 2_000  # their frames stay in a core's cache

OnProgress = Callable[[float], None]
"""Gets the share done in [0, 1]; what it raises passes through."""


def ignore_progress(share: float) -> None:
    """Where nobody asks for progress."""


@dataclass(frozen=True, kw_only=True)
class LengthPreservingInterpolation:
    """Smooth interpolation followed by `preserve_lengths`; prepared once per mesh, applied to any spectra."""

    mesh: Surface
    grid: VoxelGrid
    interpolation: VoxelInterpolation

    def apply(
        self, coefficients: Complex64[np.ndarray, "V K 3"], on_progress: OnProgress = ignore_progress
    ) -> Complex64[np.ndarray, "N K 3"]:
        """Spectra at voxels to spectra at vertices [m]: no vertex moves much more than the voxels around it."""
        attachments = self.interpolation.attachments
        smoothed = self.interpolation.apply(coefficients)
        moving, size_m = self.mesh.moving_part, self.grid.voxel_size_m
        moved = preserve_lengths(moving, smoothed, size_m, attachments=attachments, on_progress=on_progress)
        bounded = limited(self.mesh.vertices, moved, self.grid, coefficients)
        if self.interpolation.still is not None:
            bounded[self.interpolation.still] = 0
        return bounded


def length_preserving(grid: VoxelGrid, mesh: Surface) -> "LengthPreservingInterpolation | TreesInterpolation":
    """Prepare the devoxelization that products use: `smooth`, then `preserve_lengths`. Dev(·) of paper eq. 1.

    Each of several trees is devoxelized by itself, from the voxels in which it has most of the surface.
    """
    if mesh.face_tree is not None:
        return _of_trees(grid, mesh.moving_part)
    return LengthPreservingInterpolation(mesh=mesh, grid=grid, interpolation=smooth(grid, mesh))


@dataclass(frozen=True, kw_only=True)
class TreesInterpolation:
    """Several trees of one mesh, each with its own interpolation; vertices of no tree stand still."""

    num_vertices: int
    trees: tuple[tuple[Int32[np.ndarray, " _"], Int32[np.ndarray, " _"], LengthPreservingInterpolation], ...]

    def apply(
        self, coefficients: Complex64[np.ndarray, "V K 3"], on_progress: OnProgress = ignore_progress
    ) -> Complex64[np.ndarray, "N K 3"]:
        """Spectra at voxels to spectra at vertices [m]."""
        moved = np.zeros((self.num_vertices, *coefficients.shape[1:]), np.complex64)
        for done, (vertices, rows, tree) in enumerate(self.trees):
            on_progress(done / len(self.trees))
            moved[vertices] = tree.apply(np.ascontiguousarray(coefficients[rows]))
        return moved


def _of_trees(grid: VoxelGrid, mesh: Surface) -> TreesInterpolation:
    assert mesh.face_tree is not None
    tree_of_voxel = voxel_trees(mesh, grid)
    trees = []
    for number in np.unique(tree_of_voxel[tree_of_voxel >= 0]):
        rows = np.flatnonzero(tree_of_voxel == number).astype(np.int32)
        vertices, corner = np.unique(mesh.faces[mesh.face_tree == number], return_inverse=True)
        alone = Surface(vertices=mesh.vertices[vertices], faces=corner.reshape(-1, 3).astype(np.int32))
        own = replace(grid, coords=grid.coords[rows])
        interpolation = LengthPreservingInterpolation(mesh=alone, grid=own, interpolation=smooth(own, alone))
        trees.append((vertices, rows, interpolation))
    return TreesInterpolation(num_vertices=mesh.num_vertices, trees=tuple(trees))


def preserve_lengths(
    mesh: Surface,
    coefficients: Complex64[np.ndarray, "N K 3"],
    voxel_size_m: float,
    *,
    attachments: Attachments | None = None,
    on_progress: OnProgress = ignore_progress,
) -> Complex64[np.ndarray, "N K 3"]:
    """Remove the stretch of edges from a motion of the mesh's vertices [m]. Vertices at one position move as one.

    The solver takes a fixed number of steps, so that the same input gives the same bits. What hangs on another part
    (`attachments`, of the welded mesh) keeps its gap. `on_progress` gets the share done before each step; what it
    raises passes through.
    """
    welded, vertex = weld(mesh)
    first = np.unique(vertex, return_index=True)[1]
    motion = np.ascontiguousarray(coefficients[first].transpose(0, 2, 1))  # [n, 3, K]
    net = _net(welded, voxel_size_m, _weights(motion), attachments)
    steps = max(_MIN_CG_STEPS, min(_CG_STEPS, _CG_STEPS * _CG_VERTICES // len(first)))

    mean = np.ascontiguousarray(motion[:, :, :1])
    pose = _without_stretch(net, mean, mean, steps, lambda done: on_progress(_MEAN_SHARE * done))
    start = np.concatenate([pose, motion[:, :, 1:]], axis=2)
    preserved = _without_stretch(
        net, start, motion, steps, lambda done: on_progress(_MEAN_SHARE + (1 - _MEAN_SHARE) * done)
    )
    in_place = preserved.transpose(0, 2, 1)
    if attachments is not None:
        in_place = attachments.closed(in_place)
    return np.ascontiguousarray(in_place[vertex])


@dataclass(frozen=True, kw_only=True)
class _Net:
    """Edges of a mesh as springs, with the weight that draws each vertex to its target."""

    edges: Int32[np.ndarray, "E 2"]
    across: Float32[np.ndarray, "E 3"]  # at rest [m]
    length: Float32[np.ndarray, " E"]  # at rest [m]
    scale: Float32[np.ndarray, " E"]  # max(1, h / l)
    weight: Float32[np.ndarray, "M 1"]  # w, three times
    turning: scipy.sparse.csr_array  # [3n, 3n] the part of the system that does not depend on the pose

    def strain(self, pose: Complex64[np.ndarray, "n 3 1"]) -> scipy.sparse.csr_array:
        """Elongation of each edge along its direction in a pose, times `scale`, by displacement [E, 3n]."""
        across = self.across + pose.real[self.edges[:, 0], :, 0] - pose.real[self.edges[:, 1], :, 0]
        pull = across * (self.scale / np.linalg.norm(across, axis=1))[:, None]
        columns = 3 * self.edges[:, :, None] + np.arange(3)  # [E, 2, 3]
        values = np.stack([pull, -pull], axis=1)
        ends = np.arange(0, values.size + 1, 6)
        shape = (len(across), self.turning.shape[0])
        return scipy.sparse.csr_array((values.ravel(), columns.ravel(), ends), shape=shape)

    def shortening(self, motion: Complex64[np.ndarray, "n 3 K"]) -> Complex64[np.ndarray, "E K"]:
        """How much too short each edge is, times `scale`, as a spectrum over the loop."""
        num_frequencies = motion.shape[2]
        num_frames = _FRAMES_PER_BIN * num_frequencies
        to_frames = synthesis(num_frequencies, num_frames)
        to_bins = to_frames.T / (num_frames * np.repeat(bin_weights(num_frequencies, num_frames), 2))  # [T, 2K]
        parts, shortness = motion.view(np.float32), np.empty((len(self.edges), 2 * num_frequencies), np.float32)

        def fill(start: int) -> None:
            some = slice(start, start + _EDGES_AT_ONCE)
            relative = parts[self.edges[some, 0]] - parts[self.edges[some, 1]]  # [e, 3, 2K]
            frames = (relative.reshape(-1, 2 * num_frequencies) @ to_frames).reshape(-1, 3, num_frames)
            frames += self.across[some, :, None]
            length = np.sqrt(np.square(frames).sum(axis=1))
            shortness[some] = (self.scale[some, None] * (self.length[some, None] - length)) @ to_bins

        with single_thread(), ThreadPoolExecutor(num_cores()) as pool:
            list(pool.map(fill, range(0, len(self.edges), _EDGES_AT_ONCE)))
        return shortness.view(np.complex64)


def _weights(motion: Complex64[np.ndarray, "n 3 K"]) -> Float32[np.ndarray, " n"]:
    power = np.abs(motion) ** 2
    size = np.sqrt(power[:, :, 0].sum(axis=1) + 2 * power[:, :, 1:].sum(axis=(1, 2)))
    share = size / max(float(size.mean()), np.finfo(np.float32).tiny)
    weights: Float32[np.ndarray, " n"] = (1 / share.clip(1 / _LARGEST_WEIGHT, _LARGEST_WEIGHT)).astype(np.float32)
    return weights


def _net(
    mesh: Surface, voxel_size_m: float, weights: Float32[np.ndarray, " n"], attachments: Attachments | None
) -> _Net:
    edges = edges_of(mesh.faces)
    across = mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]]
    length = np.linalg.norm(across, axis=1)
    edges, across, length = edges[length > 0], across[length > 0], length[length > 0]
    scale = np.float32(voxel_size_m) / np.maximum(length, np.float32(_SHORTEST_EDGE * voxel_size_m))
    pairs = np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]])
    ties = scipy.sparse.coo_array((np.tile(TURNING * scale**2, 2), pairs), shape=(mesh.num_vertices,) * 2).tocsr()
    turning = scipy.sparse.diags_array(weights + np.asarray(ties.sum(axis=1)).ravel()) - ties
    if attachments is not None:
        links = attachments.differences()
        turning = turning + LINK * TURNING * (links.T @ links)
    each_axis = scipy.sparse.kron(turning, scipy.sparse.eye_array(3)).astype(np.float32).tocsr()
    return _Net(
        edges=edges,
        across=across,
        length=length,
        scale=np.maximum(scale, 1),
        weight=np.repeat(weights, 3)[:, None],
        turning=each_axis,
    )


def _without_stretch(
    net: _Net,
    motion: Complex64[np.ndarray, "n 3 K"],
    target: Complex64[np.ndarray, "n 3 K"],
    steps: int,
    on_progress: OnProgress,
) -> Complex64[np.ndarray, "n 3 K"]:
    """Take Gauss-Newton steps from `motion` as long as each reduces elongation; `target` is the motion to stay near."""
    shortness = net.shortening(motion)
    for done in range(_ROUNDS):
        on_progress(done / _ROUNDS)
        strain = net.strain(motion[:, :, :1])
        system = (net.turning + ELONGATION * (strain.T @ strain)).tocsr()
        now = motion.view(np.float32).reshape(3 * len(motion), -1)  # [3n, 2K]
        pull = strain @ now + shortness.view(np.float32)
        right = net.weight * target.view(np.float32).reshape(now.shape) + ELONGATION * (strain.T @ pull)
        step = conjugate_gradients(system, right, now, steps) - now
        for step_length in _STEP_LENGTHS:
            tried = np.ascontiguousarray(now + np.float32(step_length) * step).view(np.complex64).reshape(motion.shape)
            left = net.shortening(tried)
            if np.linalg.norm(left) < np.linalg.norm(shortness):
                break
        else:
            break
        motion, shortness = tried, left
    return motion
