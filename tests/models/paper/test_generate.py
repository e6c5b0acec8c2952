"""The paper's model as callers see it: deterministic, cancellable, and scaled by the wind."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dynamictree.diffusion.sampler import linear_schedule, predicted_clean, sample_ddim
from dynamictree.errors import Cancelled, InputError
from dynamictree.models.paper import generate
from dynamictree.models.paper.generate import PaperModel, at_most_unit_size
from dynamictree.models.paper.network import PaperNetwork, PaperPreset
from dynamictree.models.paper.unet import UNetShape
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

WIND = Wind(speed_m_s=5.0, direction_deg=0.0, gust=0.5)
PRESET = PaperPreset(
    resolution=32,
    encoder_base=8,
    encoder_widths=(8, 8, 8),
    unet=UNetShape(base=8, num_heads=2, num_groups=4, embedding=16, multipliers=(1, 2), attention_levels=(1,)),
    num_steps=3,
)


@pytest.fixture(scope="module")
def model() -> PaperModel:
    torch.manual_seed(0)
    network = PaperNetwork(PRESET)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    network.frequency_sizes.copy_(torch.linspace(0.02, 0.001, 16))
    return PaperModel(network, name="tiny")


def test_a_seed_decides_the_motion_which_lies_on_the_given_voxels(model: PaperModel, voxels: SurfaceVoxels) -> None:
    first, again, other = (model.generate(voxels, wind=WIND, seed=seed) for seed in (0, 0, 1))
    assert first.coefficients.shape == (len(voxels.grid), 16, 3)
    assert (first.grid.coords == voxels.grid.coords).all()
    assert first.grid.origin_m == voxels.grid.origin_m
    assert (first.coefficients == again.coefficients).all()
    assert np.abs(first.coefficients - other.coefficients).max() > 0
    assert (first.coefficients[:, 0].imag == 0).all()


def test_bands_of_few_frequencies_give_the_same_motion(model: PaperModel, voxels: SurfaceVoxels, monkeypatch) -> None:
    whole = model.generate(voxels, wind=WIND, seed=3).coefficients
    steps: list[tuple[int, int]] = []
    monkeypatch.setattr(generate, "MAX_ACTIVATIONS", 1)
    split = model.generate(voxels, wind=WIND, seed=3, on_step=lambda *step: steps.append(step)).coefficients
    np.testing.assert_allclose(split, whole, rtol=1e-3, atol=1e-7)
    assert steps == [(1, 3), (2, 3), (3, 3)]


def test_the_wind_turns_and_scales_the_motion(model: PaperModel, voxels: SurfaceVoxels) -> None:
    calm = model.generate(voxels, wind=WIND, seed=0).coefficients
    turned = model.generate(voxels, wind=replace(WIND, direction_deg=90.0), seed=0).coefficients
    np.testing.assert_allclose(turned[..., 1], calm[..., 0], atol=1e-6)
    np.testing.assert_allclose(turned[..., 0], -calm[..., 1], atol=1e-6)
    strong = model.generate(voxels, wind=replace(WIND, speed_m_s=10.0), seed=0).coefficients
    np.testing.assert_allclose(strong, calm * 2**1.4, rtol=1e-3, atol=1e-7)
    gusty = model.generate(voxels, wind=replace(WIND, gust=1.0), seed=0).coefficients
    np.testing.assert_allclose(gusty[:, 1:], calm[:, 1:] * 2, rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(gusty[:, 0], calm[:, 0], rtol=1e-3, atol=1e-7)


def test_a_step_may_cancel_and_bad_requests_are_refused(model: PaperModel, voxels: SurfaceVoxels) -> None:
    def cancel(done: int, total: int) -> None:
        raise Cancelled("enough")

    with pytest.raises(Cancelled):
        model.generate(voxels, wind=WIND, seed=0, on_step=cancel)
    with pytest.raises(InputError, match="num_steps is 0"):
        model.generate(voxels, wind=WIND, seed=0, num_steps=0)
    grid = VoxelGrid.from_coords(
        voxels.grid.coords // 2, origin_m=voxels.grid.origin_m, voxel_size_m=0.2, resolution=64
    )
    coarse = SurfaceVoxels(grid=grid, normals=np.zeros((len(grid), 3), np.float32))
    with pytest.raises(InputError, match="accepts 128, 256 and 512"):
        model.generate(coarse, wind=WIND, seed=0)


def test_what_is_drawn_from_noise_is_of_the_datas_size_however_wrong_the_network_is() -> None:
    """An error of ε is divided by √ᾱ at the first steps; it does not stay in the sample."""
    generator = torch.Generator().manual_seed(0)
    start, error = torch.randn(2, 50, 3, 6, generator=generator)
    schedule = linear_schedule()

    def predict_clean(noisy: torch.Tensor, step: int) -> torch.Tensor:
        return at_most_unit_size(predicted_clean(noisy, noisy + 0.3 * error, schedule[step]))

    drawn = sample_ddim(predict_clean, start, schedule, num_steps=20)
    assert drawn.square().mean(dim=(0, 2)).max() <= 1 + 1e-5
