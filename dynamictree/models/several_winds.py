"""One spectrum for all wind speeds: the model is asked for each band once, for the sizes of the modes there."""

from collections.abc import Callable
from dataclasses import replace

from dynamictree.models.motion_model import OnStep
from dynamictree.models.several_trees import share_of_steps
from dynamictree.spectrum import SparseVoxelSpectrum, Wind, mode_sizes
from dynamictree.wind_bands import BANDS_M_S, bands_of_sizes


def with_bands(
    generate: Callable[[Wind, OnStep | None], SparseVoxelSpectrum], wind: Wind, on_step: OnStep | None = None
) -> SparseVoxelSpectrum:
    """The spectrum of a wind, with the gains of its modes at the speeds of `BANDS_M_S`.

    Args:
        generate: the spectrum of a wind; direction, gust and seed are the same for all.
        wind: whose spectrum is returned.
        on_step: see OnStep; steps are counted over all winds.
    """
    speeds = list(dict.fromkeys((wind.speed_m_s, *BANDS_M_S.values())))
    own = generate(wind, share_of_steps(on_step, 0, len(speeds)))
    sizes = {wind.speed_m_s: mode_sizes(own.coefficients)}
    for number, speed in enumerate(speeds[1:], start=1):
        other = generate(replace(wind, speed_m_s=speed), share_of_steps(on_step, number, len(speeds)))
        sizes[speed] = mode_sizes(other.coefficients)
    return replace(own, bands=bands_of_sizes(sizes, wind.speed_m_s))
