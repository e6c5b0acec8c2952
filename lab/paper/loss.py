"""The paper's training loss: L_DM (eq. 2), then L_DM + L_LSS (eq. 3)."""

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from dynamictree.diffusion.loss import LocalSmoothness, local_smoothness, prediction_loss
from dynamictree.diffusion.sampler import NoiseSchedule, predicted_clean
from dynamictree.models.paper.network import PaperNetwork
from lab.paper.examples import PaperBatch


def paper_loss(
    network: PaperNetwork,
    batch: PaperBatch,
    clean: Float32[Tensor, "V J 6"],
    frequency: Int64[Tensor, "B J"],
    *,
    schedule: NoiseSchedule,
    generator: torch.Generator,
    smoothness: LocalSmoothness | None,
    smoothness_weight: float = 1.0,
) -> Float32[Tensor, ""]:
    """Return L_DM, plus L_LSS of the predicted clean spectrum if `smoothness` is given.

    L_LSS is weighted by ᾱ: at high noise, the clean spectrum computed from ε is an amplified error.

    Args:
        network: network in training.
        batch: batch of trees.
        clean: spectra of the trees at their frequencies, normalised to unit size.
        frequency: bins of each tree.
        schedule: noise schedule.
        generator: draws steps and noise, on the CPU.
        smoothness: constants of L_LSS; None in the first stage.
        smoothness_weight: weight of L_LSS beside L_DM; the paper gives none.
    """
    sample = batch.inputs.grids.levels[network.preset.num_halvings].sample_of_row
    step = torch.randint(0, len(schedule.alpha_bar), frequency.shape, generator=generator).to(clean.device)
    noise = torch.randn(clean.shape, generator=generator).to(clean.device)
    alpha_bar = schedule.alpha_bar[step][sample][..., None]  # [V, J, 1]
    noisy = alpha_bar.sqrt() * clean + (1 - alpha_bar).sqrt() * noise
    predicted = network(noisy, step, frequency, network.condition(batch.inputs), batch.inputs).float()
    loss = prediction_loss(predicted.flatten(0, 1), noise.flatten(0, 1))
    if smoothness is not None:
        implied = alpha_bar * predicted_clean(noisy, predicted, alpha_bar)
        neighbours = batch.neighbours, batch.distances_m
        each = [local_smoothness(one, *neighbours, weights=smoothness) for one in implied.unbind(dim=1)]
        loss = loss + smoothness_weight * torch.stack(each).mean()
    return loss
