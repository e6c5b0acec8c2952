"""What is measured between the trainings gives the motion what its regression lacks."""

import numpy as np
import torch

from dynamictree.models.small.amplitude import moving
from dynamictree.models.small.denoiser import DenoiserShape
from dynamictree.models.small.features import NUM_WIND, wind_vector
from dynamictree.models.small.network import SmallNetwork, SmallPreset
from lab.small.examples import make_example
from lab.small.whitening import measure


def test_frequencies_and_axes_get_their_shares_of_the_energy_and_no_more() -> None:
    torch.manual_seed(0)
    shape = DenoiserShape(width=8, embedding=8, num_blocks=1)
    network = SmallNetwork(SmallPreset(amplitude_width=8, amplitude_depth=1, denoiser=shape))
    example = make_example(1)
    measure(network, [example], np.random.default_rng(0))
    wind = wind_vector([example.wind])
    with torch.no_grad():
        _, log_amplitude = network.amplitude_of(example.tree, wind)
    before = moving(log_amplitude, wind[:, :NUM_WIND])
    guessed, plain = ((one.square()).sum(dim=0) for one in (before * network.energy_gain, before))
    true = example.spectrum[:, 1:].abs().square().sum(dim=0)
    torch.testing.assert_close(guessed / guessed.sum(), true / true.sum(), rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(guessed.sum(), plain.sum(), rtol=1e-3, atol=0)
