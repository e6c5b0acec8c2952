"""The paper's network and losses, at a size that a CPU can take steps with."""

import numpy as np
import pytest
import torch

from dynamictree.diffusion.sampler import linear_schedule
from dynamictree.models.paper.encoder import POSITION_FEATURES, fourier_features
from dynamictree.models.paper.network import PaperInputs, PaperNetwork, PaperPreset
from dynamictree.models.paper.unet import UNetShape
from dynamictree.sparse.level import pyramid
from dynamictree.voxel.voxelize import SurfaceVoxels
from lab.paper.examples import PaperExample, batch_of
from lab.paper.train import clean_channels, paper_loss
from lab.training.loss import LocalSmoothness, local_smoothness, nearest_voxels

SMALL = PaperPreset(
    encoder_base=8,
    encoder_widths=(8, 8, 16),
    unet=UNetShape(base=8, num_heads=2, num_groups=4, embedding=16, multipliers=(1, 2), attention_levels=(1,)),
)


@pytest.mark.slow
def test_the_full_preset_has_the_papers_size() -> None:
    with torch.device("meta"):
        network = PaperNetwork(PaperPreset())
    assert 200e6 < sum(parameter.numel() for parameter in network.parameters()) < 400e6
    assert network.unet.stem.weight.shape == (27, 6 + 128, 128)
    attended = [stage.attention is not None for level in network.unet.down for stage in level]
    assert attended == [False, False, False, False, True, True, True, True]  # levels of factors 4 and 8


def test_fourier_features_keep_the_position() -> None:
    positions = torch.rand(4, 3) * 2 - 1
    features = fourier_features(positions)
    assert features.shape == (4, POSITION_FEATURES)
    assert (features[:, :3] == positions).all()
    assert features[:, 3:].abs().max() <= 1


def slow_smoothness(spectrum: np.ndarray, centres: np.ndarray, weights: LocalSmoothness) -> float:
    total = 0.0
    for row, centre in enumerate(centres):
        distances = np.linalg.norm(centres - centre, axis=1)
        for other in np.argsort(distances, kind="stable")[1 : 1 + weights.num_neighbours]:
            real = np.linalg.norm(spectrum[row, :3] - spectrum[other, :3])
            imaginary = np.linalg.norm(spectrum[row, 3:] - spectrum[other, 3:])
            total += np.exp(-weights.falloff * distances[other]) * (real + weights.imaginary_weight * imaginary)
    return total / len(centres)


def test_local_smoothness_is_its_slow_loop_and_blind_to_constants_and_order(rng) -> None:
    weights = LocalSmoothness()
    centres = rng.random((30, 3)).astype(np.float32)
    spectrum = rng.standard_normal((30, 6)).astype(np.float32)
    neighbours = nearest_voxels(centres, weights.num_neighbours)
    loss = float(local_smoothness(torch.from_numpy(spectrum), *neighbours, weights=weights))
    assert loss == pytest.approx(slow_smoothness(spectrum, centres, weights), rel=1e-4)
    shifted = float(local_smoothness(torch.from_numpy(spectrum + 3), *neighbours, weights=weights))
    assert shifted == pytest.approx(loss, rel=1e-4)
    assert float(local_smoothness(torch.ones(30, 6), *neighbours, weights=weights)) == 0
    order = rng.permutation(30)
    turned = nearest_voxels(centres[order], weights.num_neighbours)
    permuted = float(local_smoothness(torch.from_numpy(spectrum[order]), *turned, weights=weights))
    assert permuted == pytest.approx(loss, rel=1e-5)


def test_the_loss_falls_in_a_few_steps_in_both_stages(voxels: SurfaceVoxels) -> None:
    torch.manual_seed(0)
    network = PaperNetwork(SMALL)
    coords = torch.from_numpy(voxels.grid.coords.astype(np.int64))
    height = torch.unique(coords // 4, dim=0)[:, 2].float()
    spectrum = torch.complex(height / 32 - 0.4, height / 32 - 0.4)[:, None, None].expand(-1, 16, 3)  # smooth in height
    example = PaperExample(
        coords=coords, normals=torch.from_numpy(voxels.normals), resolution=128, voxel_size_m=0.4, spectrum=spectrum
    )
    batch = batch_of([example, example], SMALL)
    optimizer = torch.optim.AdamW(network.parameters(), lr=3e-3)
    schedule, frequency = linear_schedule(), torch.tensor([[1], [5]])
    clean = clean_channels(batch, frequency, network)
    for smoothness in (None, LocalSmoothness()):
        losses = []
        for step in range(18):
            generator = torch.Generator().manual_seed(step % 3)
            loss = paper_loss(
                network, batch, clean, frequency, schedule=schedule, generator=generator, smoothness=smoothness
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
        assert np.mean(losses[-3:]) < 0.85 * np.mean(losses[:3])


@torch.no_grad()
def test_frequencies_that_share_a_pass_do_not_see_one_another(voxels: SurfaceVoxels) -> None:
    torch.manual_seed(1)
    network = PaperNetwork(SMALL)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    grids = pyramid(torch.from_numpy(voxels.grid.coords.astype(np.int64)), SMALL.num_levels)
    count = len(grids.levels[2])
    inputs = PaperInputs(positions=torch.zeros(0, 3), normals=torch.zeros(0, 3), grids=grids)
    noisy, condition = torch.randn(count, 3, 6), torch.randn(count, 16)
    step, frequency = torch.tensor([[7, 100, 900]]), torch.tensor([[1, 5, 9]])
    together = network(noisy, step, frequency, condition, inputs)
    for column in range(3):
        one = slice(column, column + 1)
        alone = network(noisy[:, one], step[:, one], frequency[:, one], condition, inputs)
        torch.testing.assert_close(together[:, one], alone, atol=1e-5, rtol=1e-4)
