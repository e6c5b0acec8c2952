"""Loss functions of diffusion models: L_DM, EDM's denoising loss, and L_LSS."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Int64
from scipy.spatial import cKDTree
from torch import Tensor


def denoising_loss(
    denoised: Float32[Tensor, "W J C"], clean: Float32[Tensor, "W J C"], sigma: Float32[Tensor, "W J 1"]
) -> Float32[Tensor, " J"]:
    """EDM's squared error, weighted by λ = (1 + σ²) / σ², equal for all noise levels. Karras et al. 2022, eq. 2."""
    weight = (1 + sigma.square()) / sigma.square()
    return (weight * (denoised - clean).square()).mean(dim=(0, 2))


def prediction_loss(predicted: Float32[Tensor, "V C"], noise: Float32[Tensor, "V C"]) -> Float32[Tensor, ""]:
    """L_DM, paper eq. 2: mean squared error of the predicted noise."""
    return (predicted - noise).square().mean()


@dataclass(frozen=True, kw_only=True)
class LocalSmoothness:
    """Weights of L_LSS, paper eq. 3; values from its section 6."""

    num_neighbours: int = 5
    falloff: float = 0.5  # alpha [1/m]
    imaginary_weight: float = 0.5  # lambda


def local_smoothness(
    spectrum: Float32[Tensor, "V 6"],
    neighbours: Int64[Tensor, "V M"],
    distances: Float32[Tensor, "V M"],
    *,
    weights: LocalSmoothness,
) -> Float32[Tensor, ""]:
    """L_LSS, paper eq. 3: weighted difference of each voxel from its nearest neighbours, at distances [m].

    `spectrum` has the real parts of x, y, z, then the imaginary ones.
    """
    difference = spectrum[:, None] - spectrum[neighbours]  # [V, M, 6]
    real = torch.linalg.vector_norm(difference[..., :3], dim=-1)
    imaginary = torch.linalg.vector_norm(difference[..., 3:], dim=-1)
    near = torch.exp(-weights.falloff * distances)
    loss: Tensor = (near * (real + weights.imaginary_weight * imaginary)).sum(dim=1).mean()
    return loss


def nearest_voxels(
    centres_m: Float32[np.ndarray, "V 3"], num_neighbours: int
) -> tuple[Int64[Tensor, "V M"], Float32[Tensor, "V M"]]:
    """Return the rows of each voxel's nearest ones, without itself, and their distances [m]."""
    distances, rows = map(np.asarray, cKDTree(centres_m).query(centres_m, k=num_neighbours + 1))
    return torch.from_numpy(rows[:, 1:].astype(np.int64)), torch.from_numpy(distances[:, 1:].astype(np.float32))
