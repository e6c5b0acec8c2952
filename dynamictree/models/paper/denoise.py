"""From what the paper's network predicts to the clean spectrum that DDIM goes on with."""

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from dynamictree.diffusion.sampler import linear_schedule, predicted_clean
from dynamictree.models.paper.network import PaperInputs, PaperNetwork

CLIP = 8.0
"""Bound on the spectrum of unit size that a step of DDIM implies: 98 % of the data's energy lies below it."""


def denoise(
    network: PaperNetwork,
    noisy: Float32[Tensor, "V J 6"],
    step: int,
    bins: Int64[Tensor, " J"],
    condition: Float32[Tensor, "V D"],
    inputs: PaperInputs,
) -> Float32[Tensor, "V J 6"]:
    """The clean spectra of one tree that the network expects at a step of the linear schedule, of the data's size."""
    predicted = network(noisy, torch.full_like(bins, step)[None], bins[None], condition, inputs)
    return at_most_unit_size(predicted_clean(noisy, predicted, linear_schedule().alpha_bar[step]))


def at_most_unit_size(clean: Float32[Tensor, "V J 6"]) -> Float32[Tensor, "V J 6"]:
    """Scale each frequency down to a root mean square of 1, which the data have, and clamp to CLIP.

    The expected clean signal is never larger than the data. Without this the first steps, where an error of ε is
    divided by √ᾱ = 0.006, end at CLIP everywhere, and later steps do not come back from there.
    """
    size = clean.square().mean(dim=(0, 2), keepdim=True).sqrt()
    return (clean / size.clamp(min=1)).clamp(-CLIP, CLIP)
