"""Common interface of the trained models."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Complex64

from dynamictree.errors import InputError
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels

OnStep = Callable[[int, int], None]
"""Called after each sampler step with the steps done and their total; an exception that it raises cancels the run."""


@runtime_checkable
class Generate(Protocol):
    """Function that generates the spectrum of one tree."""

    def __call__(self, voxels: SurfaceVoxels, *, seed: int, on_step: OnStep | None = None) -> SparseVoxelSpectrum:
        """Generate a spectrum; the same seed gives the same motion."""


@runtime_checkable
class GenerateFromBin(Protocol):
    """Function that generates the swaying bins of one tree's spectrum from `lowest_bin` on: `MotionModel.generate`."""

    def __call__(
        self, voxels: SurfaceVoxels, *, seed: int, lowest_bin: int = 1, on_step: OnStep | None = None
    ) -> SparseVoxelSpectrum:
        """Generate a spectrum; bins below `lowest_bin`, except the lean, are undefined."""


SPEEDS_M_S = (0.0, 30.0)
GUSTS = (0.0, 2.0)
MAX_STEPS = 1000


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """Parameters of one sampling run: seed of the noise, steps, first bin, and progress callback."""

    seed: int
    num_steps: int
    lowest_bin: int
    on_step: OnStep | None


class MotionModel(ABC):
    """A trained network that generates motion for a voxelized tree."""

    name: str
    """File name of the weights without its suffix."""
    paced_by_height: bool
    """Whether the pace follows the tree's height: longer default periods for tall trees, faster motion for small."""
    adds_gust_travel: bool
    """Whether its phases lack the delay of gusts along the wind, so that `gust_travel` adds it."""

    @property
    @abstractmethod
    def resolution(self) -> int:
        """Resolution of the voxel grid that `generate` needs."""

    @property
    @abstractmethod
    def default_steps(self) -> int:
        """Default number of sampler steps."""

    @abstractmethod
    def _coefficients(
        self, voxels: SurfaceVoxels, wind: Wind, sampling: Sampling
    ) -> tuple[VoxelGrid, Complex64[np.ndarray, "V K 3"], float | None]:
        """Return the grid of the motion, the motion [m], and the tree's foliage if the model estimates it."""

    def generate(
        self,
        voxels: SurfaceVoxels,
        *,
        wind: Wind,
        seed: int,
        num_steps: int | None = None,
        lowest_bin: int = 1,
        on_step: OnStep | None = None,
    ) -> SparseVoxelSpectrum:
        """Generate the spectrum of one motion; the same seed gives the same motion.

        Args:
            voxels: at `resolution`, or a power of two finer.
            wind: speed within SPEEDS_M_S, gust within GUSTS.
            seed: seed of the noise that the sampler starts from.
            num_steps: sampler steps, 1 to MAX_STEPS; by default the model's own.
            lowest_bin: swaying bins below this one are not needed and undefined; the others do not change.
            on_step: see OnStep.

        Raises:
            InputError: a resolution, voxel count, wind or number of steps that the model does not accept.
        """
        from dynamictree.models.threads import one_thread

        _check_request(wind, num_steps)
        sampling = Sampling(
            seed=seed, num_steps=num_steps or self.default_steps, lowest_bin=lowest_bin, on_step=on_step
        )
        with torch.no_grad(), one_thread():
            grid, coefficients, foliage = self._coefficients(voxels, wind, sampling)
        return SparseVoxelSpectrum(
            grid=grid, coefficients=coefficients, model=self.name, seed=seed, wind=wind, foliage=foliage
        )


def _check_request(wind: Wind, num_steps: int | None) -> None:
    """Refuse winds and numbers of steps that no model accepts."""
    for name, value, (low, high) in (("speed", wind.speed_m_s, SPEEDS_M_S), ("gust", wind.gust, GUSTS)):
        if not low <= value <= high:
            raise InputError(f"the wind's {name} is {value}; {low:g} to {high:g} is allowed")
    if not math.isfinite(wind.direction_deg):
        raise InputError(f"the wind's direction is {wind.direction_deg} degrees; it must be finite")
    if num_steps is not None and not 1 <= num_steps <= MAX_STEPS:
        raise InputError(f"num_steps is {num_steps}; 1 to {MAX_STEPS} are allowed")
