"""The interface that every trained model has."""

import math
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from dynamictree.errors import InputError
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel.voxelize import SurfaceVoxels

OnStep = Callable[[int, int], None]
"""Called after each sampler step with the steps done and their total; an exception that it raises cancels the run."""

SPEEDS_M_S = (0.0, 30.0)
GUSTS = (0.0, 2.0)
MAX_STEPS = 1000


@runtime_checkable
class MotionModel(Protocol):
    """A trained network that generates motion for a voxelized tree."""

    @property
    def name(self) -> str:
        """File name of the weights without its suffix."""

    @property
    def resolution(self) -> int:
        """Resolution of the voxel grid that `generate` needs."""

    @property
    def slower_when_tall(self) -> bool:
        """Whether a spectrum's period is by default that of the tree's height; else 4.17 s."""

    def generate(
        self,
        voxels: SurfaceVoxels,
        *,
        wind: Wind,
        seed: int,
        num_steps: int | None = None,
        on_step: OnStep | None = None,
    ) -> SparseVoxelSpectrum:
        """Generate the spectrum of one motion; the same seed gives the same motion.

        Args:
            voxels: at `resolution`, or a power of two finer.
            wind: speed within SPEEDS_M_S, gust within GUSTS.
            seed: of the noise that the sampler starts from.
            num_steps: of the sampler, 1 to MAX_STEPS; by default the model's own.
            on_step: see OnStep.

        Raises:
            InputError: a resolution, voxel count, wind or number of steps outside of what the model accepts.
        """


def check_request(wind: Wind, num_steps: int | None) -> None:
    """Refuse winds and numbers of steps that no model accepts.

    Raises:
        InputError: a value is out of range.
    """
    for name, value, (low, high) in (("speed", wind.speed_m_s, SPEEDS_M_S), ("gust", wind.gust, GUSTS)):
        if not low <= value <= high:
            raise InputError(f"the wind's {name} is {value}; {low:g} to {high:g} is allowed")
    if not math.isfinite(wind.direction_deg):
        raise InputError(f"the wind's direction is {wind.direction_deg} degrees; it must be finite")
    if num_steps is not None and not 1 <= num_steps <= MAX_STEPS:
        raise InputError(f"num_steps is {num_steps}; 1 to {MAX_STEPS} are allowed")
