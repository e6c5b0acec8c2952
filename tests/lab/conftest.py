import pytest
import torch

from dynamictree.models.small.denoiser import DenoiserShape
from dynamictree.models.small.network import SmallNetwork, SmallPreset


@pytest.fixture
def tiny_network() -> SmallNetwork:
    torch.manual_seed(0)
    shape = DenoiserShape(width=8, embedding=8, num_blocks=1)
    return SmallNetwork(SmallPreset(amplitude_width=8, amplitude_depth=1, denoiser=shape)).eval()
