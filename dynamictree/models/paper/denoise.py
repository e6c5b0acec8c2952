"""Conversion of the prediction of the paper's network to the clean spectrum for DDIM."""

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from dynamictree.diffusion.sampler import linear_schedule, predicted_clean
from dynamictree.models.paper.network import PaperInputs, PaperNetwork

CLIP = 8.0
"""Bound of the clean spectrum, of unit size, at each step of DDIM: 98 % of the data's energy lies below it."""


def denoise(
    network: PaperNetwork,
    noisy: Float32[Tensor, "V J 6"],
    step: int,
    bins: Int64[Tensor, " J"],
    condition: Float32[Tensor, "V D"],
    inputs: PaperInputs,
) -> Float32[Tensor, "V J 6"]:
    """Return the network's clean spectra of one tree at a step of the linear schedule, of at most the data's size."""
    predicted = network(noisy, torch.full_like(bins, step)[None], bins[None], condition, inputs)
    return at_most_unit_size(predicted_clean(noisy, predicted, linear_schedule().alpha_bar[step]))


def at_most_unit_size(clean: Float32[Tensor, "V J 6"]) -> Float32[Tensor, "V J 6"]:
    """Scale each frequency down to a root mean square of 1, which the data have, and clamp to CLIP.

    The expected clean signal is never larger than the data. Without this the first steps, where an error of ε is
    divided by √ᾱ = 0.006, end at CLIP everywhere, and later steps do not recover.
    """
    size = clean.square().mean(dim=(0, 2), keepdim=True).sqrt()
    return (clean / size.clamp(min=1)).clamp(-CLIP, CLIP)
