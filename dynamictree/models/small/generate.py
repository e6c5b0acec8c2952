"""Generate a spectrum with the small model: amplitudes from shape and wind, phases by the sampler."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from jaxtyping import Complex64, Float32
from torch import Tensor

from dynamictree.diffusion.sampler import karras_schedule, sample_dpm_multistep
from dynamictree.errors import InputError
from dynamictree.models.motion_model import MotionModel, Sampling
from dynamictree.models.small.denoiser import DenoiserCondition, denoise
from dynamictree.models.small.network import SmallNetwork
from dynamictree.models.small.prepared import MAX_NETWORK_VOXELS, PreparedTree, prepare_tree
from dynamictree.models.threads import best_device, run_on_cores, to_device
from dynamictree.models.voxel_resolution import halvings_between
from dynamictree.models.wind import MIN_SPEED
from dynamictree.spectrum import Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

NUM_STEPS = 4
BAND = 1
"""Frequencies that one thread denoises together: hidden layers of two exceed a core's cache (8 % slower)."""
MAX_VOXELS = 2_400_000
"""Limit of the spectrum's grid, at 400 bytes per voxel. The network reads fewer (`prepared.MAX_NETWORK_VOXELS`)."""


def noise_at(speed_m_s: float, seed: int, draw: Callable[[torch.Generator], Tensor]) -> Tensor:
    """Return the noise of a seed at a speed; it becomes independent noise within an octave of the speed.

    The wind carries turbulence past the tree unchanged (Taylor): frequency f is driven by eddies of wave number f / U,
    and at another speed by other eddies.
    """
    octave = math.log2(max(speed_m_s, MIN_SPEED))
    low = math.floor(octave)
    below, above = (
        draw(torch.Generator().manual_seed(int(np.random.SeedSequence([seed, one % 2**32]).generate_state(1)[0])))
        for one in (low, low + 1)
    )
    turn = math.pi / 2 * (octave - low)
    return math.cos(turn) * below + math.sin(turn) * above


class SmallModel(MotionModel):
    """Amplitudes by regression, phases by diffusion, whose sampler runs on the GPU where there is one."""

    paced_by_height = adds_gust_travel = True

    def __init__(
        self,
        network: SmallNetwork,
        *,
        name: str,
        max_network_voxels: int = MAX_NETWORK_VOXELS,
        device: torch.device | None = None,
    ) -> None:
        self.network, self.name, self.device = network.eval().requires_grad_(False), name, device or best_device()
        self.network.denoiser.to(self.device)
        self.max_network_voxels = max_network_voxels

    @property
    def resolution(self) -> int:
        """Resolution of the voxel grid that the network works on."""
        return self.network.preset.resolution

    @property
    def default_steps(self) -> int:
        """Four steps; more change little."""
        return NUM_STEPS

    def _coefficients(
        self, voxels: SurfaceVoxels, wind: Wind, sampling: Sampling
    ) -> tuple[VoxelGrid, Complex64[np.ndarray, "V K 3"], float | None]:
        self._check(voxels.grid)
        prepared = self.prepare(voxels, wind)
        draw = partial(prepared.noise.draw, self.network.common_share)
        start = prepared.noise.field(noise_at(wind.speed_m_s, sampling.seed, draw))
        whitened = self._denoise(prepared, prepared.noise.pool.apply(start), sampling)
        coefficients = prepared.to_metres(prepared.assemble(start, whitened))
        return voxels.grid, coefficients, prepared.foliage

    def prepare(self, voxels: SurfaceVoxels, wind: Wind) -> PreparedTree:
        """Compute the deterministic part: amplitudes, lean, and the matrices between nodes and voxels."""
        return prepare_tree(self.network, voxels, wind, max_voxels=self.max_network_voxels)

    def _denoise(
        self, prepared: PreparedTree, noise: Float32[Tensor, "W J 6"], sampling: Sampling
    ) -> Float32[Tensor, "W J 6"]:
        """Sample a whitened spectrum on the nodes. Frequencies are independent, so bands of them run on all cores."""
        preset, device = self.network.preset, self.device
        sigmas = karras_schedule(sampling.num_steps, sigma_min=preset.sigma_min, sigma_max=preset.sigma_max)
        first = (sampling.lowest_bin - 1) // BAND * BAND
        band = BAND if device.type == "cpu" else preset.num_frequencies
        bands = [slice(k, k + band) for k in range(first, preset.num_frequencies - 1, band)]
        frequency = torch.arange(1, preset.num_frequencies)[None]
        given = (prepared.nodes, prepared.wind, frequency, prepared.node_log_amplitude, prepared.neighbourhood)
        nodes, wind, frequency, log_size, around = to_device(device, given)
        condition = self.network.denoiser.condition(
            nodes, wind, frequency=frequency, log_amplitude=log_size, neighbourhood=around
        )
        denoisers = [partial(self._denoise_band, condition.of_band(band)) for band in bands]

        def denoise_all(noisy: Tensor, sigma: float) -> Tensor:
            calls = [partial(one, noisy[:, band], sigma) for one, band in zip(denoisers, bands, strict=True)]
            return torch.cat([noisy[:, :first], *run_on_cores(calls, device)], dim=1)

        start = noise.to(device) * float(sigmas[0])
        return sample_dpm_multistep(denoise_all, start, sigmas, on_step=sampling.on_step).cpu()

    def _denoise_band(self, condition: DenoiserCondition, noisy: Tensor, sigma: float) -> Tensor:
        sigmas = torch.full_like(condition.frequency, sigma, dtype=noisy.dtype)
        return denoise(self.network.denoiser, noisy, sigmas, condition)

    def _check(self, grid: VoxelGrid) -> None:
        halvings_between(grid, self.resolution, self.name)
        if len(grid) > MAX_VOXELS:
            raise InputError(
                f"the tree has {len(grid):,} voxels; at most {MAX_VOXELS:,} are allowed; take a lower resolution"
            )
