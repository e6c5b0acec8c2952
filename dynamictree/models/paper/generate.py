"""Generate a spectrum with the paper's network: DDIM, frequency by frequency."""

import numpy as np
import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.diffusion.channels import CHANNELS, unpack_channels
from dynamictree.diffusion.sampler import sample_ddim
from dynamictree.diffusion.schedule import linear_schedule
from dynamictree.errors import InputError
from dynamictree.models.motion_model import OnStep, check_request
from dynamictree.models.paper.examples import unit_positions, wind_sizes
from dynamictree.models.paper.network import PaperNetwork
from dynamictree.models.threads import one_thread
from dynamictree.models.voxel_resolution import coarsened, halvings_between
from dynamictree.models.wind import wind_axes
from dynamictree.sparse.level import Pyramid, pyramid
from dynamictree.sparse.matrices import raise_matrix
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

OUTPUT_RESOLUTION = 128
"""Spectra of a coarser grid are interpolated onto this one, which the rest of the method works on."""
MAX_ACTIVATIONS = 4_000_000
"""Values in one layer of the U-Net's first level that a pass may have; frequencies are split into passes by it.
The peak of memory was not measured."""
MAX_VOXELS = 150_000  # of the spectrum's grid
CLIP = 8.0
"""Bound on the spectrum of unit size that a step of DDIM implies: 98 % of the data's energy lies below it."""


class PaperModel:
    """The paper's network with its sampler, on the GPU where there is one: a `MotionModel`."""

    def __init__(self, network: PaperNetwork, *, name: str) -> None:
        self.network = network.eval().requires_grad_(False).to("cuda" if torch.cuda.is_available() else "cpu")
        self.name = name

    @property
    def resolution(self) -> int:
        """Resolution of the voxel grid that the encoder reads."""
        return self.network.preset.condition_resolution

    def generate(
        self,
        voxels: SurfaceVoxels,
        *,
        wind: Wind,
        seed: int,
        num_steps: int | None = None,
        on_step: OnStep | None = None,
    ) -> SparseVoxelSpectrum:
        """Generate the spectrum of one motion, see `MotionModel.generate`.

        The wind's direction turns the motion and its speed and gust scale it; the paper's network knows no wind.
        """
        check_request(wind, num_steps)
        preset = self.network.preset
        fine, _ = coarsened(voxels, halvings_between(voxels.grid, self.resolution, self.name))
        grids = pyramid(torch.from_numpy(fine.grid.coords.astype(np.int64)), preset.num_levels)
        count = len(grids.levels[preset.num_halvings])
        if count > MAX_VOXELS:
            allowed = f"at most {MAX_VOXELS:,} are allowed; take a lower resolution"
            raise InputError(f"the tree has {count:,} voxels at {preset.resolution}; {allowed}")
        with torch.no_grad(), one_thread():
            unit = self._sample(fine, grids, seed, num_steps or preset.num_steps, on_step)
        height_m = (int(np.ptp(fine.grid.coords[:, 2])) + 1) * fine.grid.voxel_size_m
        sizes = self.network.frequency_sizes.cpu().numpy() * wind_sizes(wind, preset.num_frequencies) * height_m
        coefficients = (unit * sizes[:, None]) @ wind_axes(wind)
        coefficients[:, 0].imag = 0
        grid, coefficients = _on_output_grid(fine.grid, grids, preset.num_halvings, coefficients)
        return SparseVoxelSpectrum(
            grid=grid, coefficients=coefficients.astype(np.complex64), model=self.name, seed=seed, wind=wind
        )

    def _sample(
        self, fine: SurfaceVoxels, grids: Pyramid, seed: int, num_steps: int, on_step: OnStep | None
    ) -> Complex64[np.ndarray, "V K 3"]:
        """Spectra of unit size, all frequencies, as many per pass as MAX_ACTIVATIONS allows."""
        network, preset = self.network, self.network.preset
        device = network.frequency_sizes.device
        grids = grids.to(device)
        positions = unit_positions(torch.from_numpy(fine.grid.coords.astype(np.int64)), fine.grid.resolution)
        condition = network.encoder(positions.to(device), torch.from_numpy(fine.normals).to(device), grids)
        count = len(condition)
        start = torch.randn(
            preset.num_frequencies, count, CHANNELS, generator=torch.Generator().manual_seed(seed)
        )  # frequency first, so that the noise of a bin does not depend on the others
        per_pass = max(1, MAX_ACTIVATIONS // (count * preset.unet.base))
        passes = torch.split(torch.arange(preset.num_frequencies), per_pass)
        generated = []
        for index, bins in enumerate(passes):

            def predict_noise(noisy: Tensor, step: int, bins: Tensor = bins) -> Tensor:
                steps = torch.full((1, len(bins)), step, device=device)
                noise: Tensor = network(noisy, steps, bins[None].to(device), condition, grids)
                return noise

            def report(done: int, total: int, before: int = index * num_steps) -> None:
                if on_step is not None:
                    on_step(before + done, len(passes) * total)

            noise = start[bins].transpose(0, 1).contiguous().to(device)
            schedule = linear_schedule().to(device)
            generated.append(
                sample_ddim(predict_noise, noise, schedule, num_steps=num_steps, clip=CLIP, on_step=report)
            )
        return _complex_rows(torch.cat(generated, dim=1))


def _complex_rows(channels: Float32[Tensor, "V K 6"]) -> Complex64[np.ndarray, "V K 3"]:
    rows: Complex64[np.ndarray, "V K 3"] = unpack_channels(channels.cpu()).numpy()
    return rows


def _on_output_grid(
    fine: VoxelGrid, grids: Pyramid, halvings: int, coefficients: np.ndarray
) -> tuple[VoxelGrid, np.ndarray]:
    """The spectrum on its own grid, or interpolated along touching voxels onto a finer one up to OUTPUT_RESOLUTION."""
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
        return grid, coefficients
    raised = raise_matrix(grids, halvings, target) @ coefficients.reshape(len(coefficients), -1)
    return grid, raised.reshape(-1, *coefficients.shape[1:])
