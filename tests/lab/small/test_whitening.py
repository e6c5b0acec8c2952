"""What is measured between the trainings gives the motion what its regression lacks."""

import numpy as np
import torch

from dynamictree.models.small.amplitude import moving
from dynamictree.models.small.correlated_noise import NUM_SCALES, noise_basis
from dynamictree.models.small.denoiser import DenoiserShape
from dynamictree.models.small.features import NUM_WIND, coarsen_features, wind_vector
from dynamictree.models.small.network import SmallNetwork, SmallPreset
from lab.small.examples import make_example
from lab.small.whitening import fit_shares, measure


def test_frequencies_and_axes_get_the_energy_that_the_tree_has() -> None:
    torch.manual_seed(0)
    shape = DenoiserShape(width=8, embedding=8, num_blocks=1)
    network = SmallNetwork(SmallPreset(amplitude_width=8, amplitude_depth=1, denoiser=shape)).eval()
    example = make_example(1)
    measure(network, [example], np.random.default_rng(0))
    wind = wind_vector([example.wind])
    with torch.no_grad():
        _, log_amplitude = network.amplitude_of(example.tree, wind)
    before = moving(log_amplitude, wind[:, :NUM_WIND])
    guessed = (before * network.energy_gain).square().sum(dim=0)
    true = example.spectrum[:, 1:].abs().square().sum(dim=0)
    torch.testing.assert_close(guessed, true, rtol=1e-3, atol=0)


def test_fitted_shares_are_those_that_made_the_field() -> None:
    nodes = coarsen_features(make_example(1).tree, 2)
    true = torch.zeros(2, NUM_SCALES)
    true[0, 0], true[0, -1] = 0.25, 0.75  # white, and one for the whole tree
    true[1, 0], true[1, 4] = 0.5, 0.5  # white, and along the stems
    generator = torch.Generator().manual_seed(0)
    drawn = noise_basis(nodes.grids, nodes.links).draw(true, generator, channels=1000).numpy()
    spectrum = ((drawn[..., :500] + 1j * drawn[..., 500:]) / np.sqrt(2)).astype(np.complex64)
    shares = fit_shares([spectrum], [nodes], np.random.default_rng(0))
    np.testing.assert_allclose(shares, true.numpy(), atol=0.08)
