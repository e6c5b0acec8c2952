"""Spectra of the leaves' flutter in the simulator: resonances with random phases."""

import numpy as np
from jaxtyping import Complex64, Float64, Int

from dynamictree.wind.flutter import LINE_WIDTH, SLOWEST_HZ, TWIG_SHARE, leaf_frequencies


def resonance(frequency_hz: Float64[np.ndarray, " J"], own_hz: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, "M J"]:
    """Return the amplitude of each leaf at each frequency of a loop; the squares sum to 1."""
    offset = (frequency_hz - own_hz[:, None]) / (LINE_WIDTH * own_hz[:, None])
    amplitude = np.sqrt(1 / (1 + offset**2)) * (frequency_hz >= SLOWEST_HZ)
    normalised: Float64[np.ndarray, "M J"] = amplitude / np.sqrt((amplitude**2).sum(axis=1, keepdims=True))
    return normalised


def unit_turns(
    twig: Int[np.ndarray, " M"], frequency_hz: Float64[np.ndarray, " J"], rng: np.random.Generator
) -> Complex64[np.ndarray, "M 2 J"]:
    """Sample spectra of each leaf's rotations across its axis and about it, of unit variance; `twig` numbers twigs."""
    twigs, own = np.unique(twig, return_inverse=True)
    own_hz = leaf_frequencies(len(twigs), rng)[own]
    of_twig, of_leaf = (
        rng.standard_normal((rows, 2, len(frequency_hz), 2), np.float32) @ np.array([1, 1j], np.complex64)
        for rows in (len(twigs), len(twig))
    )
    together = np.sqrt(TWIG_SHARE) * of_twig[own] + np.sqrt(1 - TWIG_SHARE) * of_leaf
    return np.asarray(0.5 * together * resonance(frequency_hz, own_hz)[:, None], np.complex64)
