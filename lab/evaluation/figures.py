"""Compare one motion with the true one in all figures."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Float32, Int32, Int64
from torch import Tensor

from dynamictree.mesh import edges_of
from dynamictree.voxel.voxelize import surface_average
from lab.evaluation.held_out_trees import HeldOutTree
from lab.evaluation.metrics import (
    amplitude,
    centroid_correlation,
    downwind_lean,
    edge_stretch,
    energy_by_frequency,
    log_amplitude_agreement,
    loop_jump,
    phase_agreement,
    root_share,
    roughness,
    smoothness_loss,
)
from lab.training.loss import LocalSmoothness, nearest_voxels


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Figures of one method on one tree. Ratios are relative to the figure of the true motion."""

    log_amplitude_correlation: float
    log_amplitude_rmse: float
    centroid_correlation: float
    roughness_ratio: float
    smoothness_loss_ratio: float  # ratio of L_LSS of the voxel means
    energy_distance: float  # half the sum of absolute differences of the energy shares by frequency
    size_ratio: float  # median amplitude over the truth's
    stretch_median: float
    stretch_p99: float
    root_share: float  # largest root displacement [share of the height]
    loop_jump: float  # jump at the loop's end over the largest step inside
    lean_ratio: float
    phase_agreement: float
    phase_agreement_truth: float


@dataclass(frozen=True, kw_only=True)
class TreeReference:
    """Prepared data of a tree, with which all methods are measured."""

    tree: HeldOutTree
    edges: Int32[np.ndarray, "E 2"]
    average: scipy.sparse.csr_array  # [V, N]
    neighbours: Int64[Tensor, "V M"]
    distances: Float32[Tensor, "V M"]

    @classmethod
    def of(cls, tree: HeldOutTree) -> "TreeReference":
        """Prepare the reference of a tree."""
        neighbours, distances = nearest_voxels(tree.voxels.grid.centres_m, LocalSmoothness().num_neighbours)
        return cls(
            tree=tree,
            edges=edges_of(tree.mesh.faces),
            average=surface_average(tree.mesh, tree.voxels.grid).astype(np.float32),
            neighbours=neighbours,
            distances=distances,
        )

    def on_voxels(self, motion: Complex64[np.ndarray, "N K 3"]) -> Complex64[np.ndarray, "V K 3"]:
        """Average a motion over the surface in each voxel."""
        flat = np.ascontiguousarray(self.average @ motion.reshape(len(motion), -1).view(np.float32))
        return flat.view(np.complex64).reshape(-1, *motion.shape[1:])

    def smoothness(self, motion: Complex64[np.ndarray, "N K 3"]) -> float:
        """Return L_LSS of the voxel means."""
        return smoothness_loss(self.on_voxels(motion), self.neighbours, self.distances)


def figures_of(guess: Complex64[np.ndarray, "N K 3"], reference: TreeReference) -> Figures:
    """Compute all figures of one motion."""
    tree, edges = reference.tree, reference.edges
    vertices, height_m = tree.mesh.vertices, tree.mesh.height_m
    correlation, rmse = log_amplitude_agreement(guess, tree.truth, height_m)
    median, extreme = edge_stretch(guess, vertices, edges)
    lean = [downwind_lean(one, vertices, tree.wind.direction_deg) for one in (guess, tree.truth)]
    return Figures(
        log_amplitude_correlation=correlation,
        log_amplitude_rmse=rmse,
        centroid_correlation=centroid_correlation(guess, tree.truth),
        roughness_ratio=roughness(guess, edges) / roughness(tree.truth, edges),
        smoothness_loss_ratio=reference.smoothness(guess) / reference.smoothness(tree.truth),
        energy_distance=float(np.abs(energy_by_frequency(guess) - energy_by_frequency(tree.truth)).sum() / 2),
        size_ratio=float(np.median(amplitude(guess)) / np.median(amplitude(tree.truth))),
        stretch_median=median,
        stretch_p99=extreme,
        root_share=root_share(guess, vertices),
        loop_jump=loop_jump(guess),
        lean_ratio=lean[0] / lean[1],
        phase_agreement=phase_agreement(guess, edges),
        phase_agreement_truth=phase_agreement(tree.truth, edges),
    )
