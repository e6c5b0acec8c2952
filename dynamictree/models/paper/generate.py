"""Generate a spectrum with the paper's network: DDIM, frequency by frequency."""

from functools import partial

import numpy as np
import torch
from jaxtyping import Complex64, Float32, Int64
from torch import Tensor

from dynamictree.diffusion.channels import CHANNELS, unpack_channels
from dynamictree.diffusion.sampler import linear_schedule, predicted_clean, sample_ddim
from dynamictree.errors import InputError
from dynamictree.models.motion_model import MotionModel, Sampling
from dynamictree.models.paper.network import PaperInputs, PaperNetwork, unit_positions
from dynamictree.models.threads import best_device, run_on_cores, to_device
from dynamictree.models.voxel_resolution import coarsened, halvings_between
from dynamictree.models.wind import wind_axes, wind_sizes
from dynamictree.sparse.level import Pyramid, pyramid
from dynamictree.sparse.matrices import upsample_matrix
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

OUTPUT_RESOLUTION = 128
"""Resolution to which coarser spectra are interpolated, as the rest of the method works on it."""
BAND = 8
"""Frequencies that one thread denoises together."""
MAX_ACTIVATIONS = 4_000_000
"""Most values that a band of frequencies has in one layer of the U-Net's first level."""
MAX_VOXELS = 150_000  # limit of the spectrum's grid
CLIP = 8.0
"""Bound of the clean spectrum, of unit size, at each step of DDIM: 98 % of the data's energy lies below it."""


class PaperModel(MotionModel):
    """The paper's network with its sampler, on the GPU where there is one."""

    paced_by_height = adds_gust_travel = False  # the paper has one period and no delay

    def __init__(self, network: PaperNetwork, *, name: str) -> None:
        self.network = network.eval().requires_grad_(False).to(best_device())
        self.name = name

    @property
    def resolution(self) -> int:
        """Resolution of the voxel grid that the encoder reads."""
        return self.network.preset.condition_resolution

    @property
    def default_steps(self) -> int:
        """The preset's number of steps."""
        return self.network.preset.num_steps

    def _coefficients(
        self, voxels: SurfaceVoxels, wind: Wind, sampling: Sampling
    ) -> tuple[VoxelGrid, Complex64[np.ndarray, "V K 3"], None]:
        """Sample the motion without wind, then turn it by the wind's direction and scale it by speed and gust."""
        preset = self.network.preset
        fine, _ = coarsened(voxels, halvings_between(voxels.grid, self.resolution, self.name))
        coords = torch.from_numpy(fine.grid.coords.astype(np.int64))
        inputs = PaperInputs(
            positions=unit_positions(coords, fine.grid.resolution),
            normals=torch.from_numpy(fine.normals),
            grids=pyramid(coords, preset.num_levels),
        )
        count = len(inputs.grids.levels[preset.num_halvings])
        if count > MAX_VOXELS:
            allowed = f"at most {MAX_VOXELS:,} are allowed; take a lower resolution"
            raise InputError(f"the tree has {count:,} voxels at {preset.resolution}; {allowed}")
        bins = torch.arange(preset.num_frequencies)
        # frequency first, so that the noise of a bin does not depend on the others
        generator = torch.Generator().manual_seed(sampling.seed)
        start = torch.randn(len(bins), count, CHANNELS, generator=generator).transpose(0, 1)
        unit = unpack_channels(self._sample(inputs, bins, start, sampling).cpu()).numpy()
        height_m = fine.grid.height_m
        sizes = self.network.frequency_sizes.cpu().numpy() * wind_sizes(wind, preset.num_frequencies) * height_m
        coefficients = (unit * sizes[:, None]) @ wind_axes(wind)
        coefficients[:, 0].imag = 0
        return *_on_output_grid(fine.grid, inputs.grids, preset.num_halvings, coefficients), None

    def _sample(
        self, inputs: PaperInputs, bins: Int64[Tensor, " J"], start: Float32[Tensor, "V J 6"], sampling: Sampling
    ) -> Float32[Tensor, "V J 6"]:
        """Sample spectra of unit size. Frequencies are independent, so bands of them run on all cores."""
        device = self.network.frequency_sizes.device
        inputs, schedule = to_device(device, (inputs, linear_schedule()))
        condition = self.network.condition(inputs)
        band = max(1, MAX_ACTIVATIONS // (len(condition) * self.network.preset.unet.base))
        bands = torch.split(torch.arange(len(bins)), min(band, BAND) if device.type == "cpu" else band)

        def predict_band(noisy: Tensor, step: int, band: Tensor) -> Tensor:
            return denoise(self.network, noisy[:, band], step, bins[band].to(device), condition, inputs)

        def predict_clean(noisy: Tensor, step: int) -> Tensor:
            calls = [partial(predict_band, noisy, step, one) for one in bands]
            return torch.cat(run_on_cores(calls, device), dim=1)

        noise = start.contiguous().to(device)
        return sample_ddim(predict_clean, noise, schedule, num_steps=sampling.num_steps, on_step=sampling.on_step)


def _on_output_grid(
    fine: VoxelGrid, grids: Pyramid, halvings: int, coefficients: np.ndarray
) -> tuple[VoxelGrid, Complex64[np.ndarray, "V K 3"]]:
    """Return the spectrum on its grid, or interpolated along touching voxels to one of up to OUTPUT_RESOLUTION."""
    target = halvings
    while target > 0 and fine.resolution >> target < OUTPUT_RESOLUTION:
        target -= 1
    grid = VoxelGrid(
        coords=grids.levels[target].coords.numpy().astype(np.int32),
        origin_m=fine.origin_m,
        voxel_size_m=fine.voxel_size_m * (1 << target),
        resolution=fine.resolution >> target,
    )
    if target == halvings:
        return grid, coefficients.astype(np.complex64)
    raised = upsample_matrix(grids, halvings, target) @ coefficients.reshape(len(coefficients), -1)
    return grid, raised.reshape(-1, *coefficients.shape[1:]).astype(np.complex64)


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
    return at_most_unit_size(predicted_clean(noisy, predicted, linear_schedule()[step]))


def at_most_unit_size(clean: Float32[Tensor, "V J 6"]) -> Float32[Tensor, "V J 6"]:
    """Scale each frequency down to a root mean square of 1, which the data have, and clamp to CLIP.

    The expected clean signal is never larger than the data. Without this the first steps, where an error of ε is
    divided by √ᾱ = 0.006, end at CLIP everywhere, and later steps do not recover.
    """
    size = clean.square().mean(dim=(0, 2), keepdim=True).sqrt()
    return (clean / size.clamp(min=1)).clamp(-CLIP, CLIP)
