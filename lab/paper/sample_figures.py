"""Figures of one generated motion against the true one, to monitor training."""

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor, nn

from dynamictree.diffusion.channels import pack_channels
from dynamictree.diffusion.sampler import linear_schedule, sample_ddim
from dynamictree.models.paper.generate import denoise
from dynamictree.models.paper.network import PaperNetwork
from dynamictree.models.threads import to_device
from lab.paper.examples import PaperExample, batch_of


@torch.no_grad()
def sample_figures(network: nn.Module, example: PaperExample, *, num_steps: int, seed: int = 0) -> dict[str, float]:
    """Return roughness ratio, error of ln size, and correlation of ln amplitude, over k ≥ 1 of one tree."""
    assert isinstance(network, PaperNetwork)
    preset, device = network.preset, network.frequency_sizes.device
    batch = to_device(device, batch_of([example], preset))
    bins = torch.arange(1, preset.num_frequencies, device=device)
    truth = pack_channels(batch.spectrum[:, 1:])  # [V, J, 6]
    condition, schedule = network.condition(batch.inputs), to_device(device, linear_schedule())

    def predict_clean(noisy: Tensor, step: int) -> Tensor:
        return denoise(network, noisy, step, bins, condition, batch.inputs)

    start = torch.randn(truth.shape, generator=torch.Generator().manual_seed(seed)).to(device)
    drawn = sample_ddim(predict_clean, start, schedule, num_steps=num_steps) * network.frequency_sizes[1:, None]
    rough = [roughness(one, batch.neighbours) for one in (drawn, truth)]
    power = [one.square().sum(dim=(1, 2)) for one in (drawn, truth)]
    mean_power = [one.square().mean(dim=(0, 2)).log() for one in (drawn, truth)]
    return {
        "roughness_ratio": round(float((rough[0] / rough[1]).mean()), 3),
        "ln_size_error": round(float((mean_power[0] - mean_power[1]).abs().mean() / 2), 3),
        "log_amplitude_correlation": round(float(np.corrcoef([one.log().cpu().numpy() for one in power])[0, 1]), 3),
    }


def roughness(field: Float32[Tensor, "V J 6"], rows: Tensor) -> Float32[Tensor, " J"]:
    """Return the mean difference from the nearest voxels over the mean size, per frequency."""
    across = torch.linalg.vector_norm(field[:, None] - field[rows], dim=-1).mean(dim=(0, 1))
    ratio: Tensor = across / torch.linalg.vector_norm(field, dim=-1).mean(dim=0)
    return ratio
