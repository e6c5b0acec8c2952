"""The losses, as functions of numbers. A loss is a few lines."""

from jaxtyping import Float32
from torch import Tensor


def denoising_loss(
    denoised: Float32[Tensor, "W J C"],
    clean: Float32[Tensor, "W J C"],
    sigma: Float32[Tensor, "W J 1"],
) -> Float32[Tensor, " J"]:
    """EDM's weighted squared error, λ = (1 + σ²) / σ²: every noise level weighs the same. Karras et al. 2022, eq. 2."""
    weight = (1 + sigma.square()) / sigma.square()
    return (weight * (denoised - clean).square()).mean(dim=(0, 2))
