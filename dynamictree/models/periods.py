"""Spectra of any period from a model of one period: tall trees get a longer loop, small trees a faster motion.

In the simulator that the models learn from, the response of a stem at bin k depends only on its slenderness and on
k / (f P), with its natural frequency f and the period P. So a tree of height H with period λP moves like the same tree
of height h with period P, enlarged H / h times, where f(h) = λ f(H): the model generates that smaller tree. Above its
K bins, motion is flutter of leaves, which do not grow with the tree: for these bins the model generates the tree at its
own size.

A small tree is faster than the simulator's, by a factor that depends on its height (`modal.real_trees.speedup_of`). As
the response depends only on k / (f P), its bins are the model's at that multiple of the frequency. For a tree smaller
than the model learned from, the model generates it enlarged, which is slower, and the motion is scaled down.

A bin of the model that is wider than a bin of the spectrum is split into several with the same total power and random
phases, so that flutter does not repeat within the loop.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex64

from dynamictree.modal.real_trees import height_law_hz, learned_law_hz, loop_times, speedup_of
from dynamictree.models.motion_model import Generate, GenerateFromBin, OnStep
from dynamictree.models.several_trees import steps_of_run
from dynamictree.spectrum import FPS, NUM_FRAMES, NUM_FREQUENCIES, SparseVoxelSpectrum, mode_sizes
from dynamictree.voxel.voxelize import SurfaceVoxels

PERIOD_S = NUM_FRAMES / FPS
"""Period of the motions that models learn from: 4.17 s."""
MAX_FREQUENCIES = 48
"""K of the longest periods: three times the memory and files of K = 16, and flutter up to 2.8 Hz at 16.7 s. Small
trees have more, in proportion to their faster motion."""
MAX_VALUES = 38_400_000
"""Limit of voxels times frequencies, above which flutter is left out: 0.9 GB."""
LEARNED_FROM_M = 2.0
"""Height below which the data has only two species."""


def period_by_height(voxels: SurfaceVoxels) -> float:
    """Return the period for a spectrum of these voxels [s]; of several trees the tallest decides."""
    numbers = np.zeros(len(voxels.grid), np.int64) if voxels.tree is None else voxels.tree
    heights = [np.ptp(voxels.grid.coords[numbers == number, 2]) + 1 for number in np.unique(numbers)]
    return PERIOD_S * max(loop_times(int(height) * voxels.grid.voxel_size_m) for height in heights)


def with_period(generate: GenerateFromBin, period_s: float, *, quick_when_small: bool = True) -> Generate:
    """Return a function that generates spectra of this period, rounded to whole frames, of one tree each.

    At 4.17 s, trees that are not small move as the model generates them; `quick_when_small` makes small ones faster.
    """
    num_frames = round(period_s * FPS)

    def generate_in_period(voxels: SurfaceVoxels, *, seed: int, on_step: OnStep | None = None) -> SparseVoxelSpectrum:
        longer, height_m = num_frames / NUM_FRAMES, voxels.grid.height_m
        quicker = speedup_of(height_m) if quick_when_small else 1.0
        if longer == quicker == 1:
            return generate(voxels, seed=seed, on_step=on_step)
        times = min(max(longer, 1.0), float(loop_times(height_m)))
        rng = np.random.default_rng(seed)
        highest = min(round(MAX_FREQUENCIES * quicker), max(MAX_VALUES // len(voxels.grid), NUM_FREQUENCIES)) - 1
        magnified = max(LEARNED_FROM_M / height_m, 1.0) if quick_when_small else 1.0
        flutter_bins = spread_bins(longer, highest, rng, quicker=quicker * np.sqrt(magnified)) / magnified
        shorter_m = (learned_law_hz(1.0) / (times * height_law_hz(height_m))) ** 2  # the tree h of the docstring
        enlarged = max(height_m / float(shorter_m), 1.0)
        sway_bins = enlarged * spread_bins(longer / times, highest, rng)
        own = flutter_bins[len(sway_bins) if times > 1 else 0 :].any(axis=0)
        lowest = max(int(own.argmax()), 1) if own.any() else NUM_FREQUENCIES
        steps = steps_of_run(on_step, 0, 2 if times > 1 else 1)
        flutter = generate(_scaled_down(voxels, 1 / magnified), seed=seed, lowest_bin=lowest, on_step=steps)
        coefficients = _mixed(flutter, flutter_bins)
        if times > 1:
            sway = generate(_scaled_down(voxels, enlarged), seed=seed, on_step=steps_of_run(on_step, 1, 2))
            slow = _mixed(sway, sway_bins)
            coefficients[:, : slow.shape[1]] = slow
        grid = flutter.grid if magnified == 1 else voxels.grid
        return replace(flutter, grid=grid, coefficients=coefficients, num_frames=num_frames)

    return generate_in_period


def spread_bins(
    longer: float, highest: int, rng: np.random.Generator, *, quicker: float = 1.0
) -> Complex64[np.ndarray, "K J"]:
    """Return the matrix from bins of one period to those of one `longer` times as long, up to `highest`; keeps power.

    A bin goes to the nearest frequencies; bins that are split or merged get random phases. If the motion is `quicker`,
    frequencies above the last one are left out, and the slowest bin also fills the slower ones: that far below its
    natural frequency a tree follows the gusts.
    """
    if longer == quicker == 1:
        return np.eye(NUM_FREQUENCIES, dtype=np.complex64)
    last, scale = NUM_FREQUENCIES - 1, longer * quicker
    top = min(max(int(np.ceil((last + 0.5) * longer)) - 1, 1), highest)
    if scale > 1:
        target = np.arange(1, top + 1)
        source = np.maximum(np.rint(target / scale).astype(np.int64), int(quicker > 1))
    else:
        source = np.arange(1, NUM_FREQUENCIES)
        target = np.maximum(np.rint(source * scale).astype(np.int64), 1)
    target, source = target[source > 0], source[source > 0]
    phase = rng.uniform(0, 2 * np.pi, len(source))
    matrix = np.zeros((target.max() + 1, NUM_FREQUENCIES), np.complex64)
    matrix[0, 0] = 1
    matrix[target, source] = np.exp(1j * phase) / np.sqrt(np.bincount(source)[source])
    return matrix


def _mixed(spectrum: SparseVoxelSpectrum, matrix: Complex64[np.ndarray, "K J"]) -> Complex64[np.ndarray, "V K 3"]:
    """Multiply each voxel's spectrum by the matrix, in place if square; sums of bins get their parts' total power."""
    voxels_at_once = 65_536
    own: Complex64[np.ndarray, "V J 3"] = spectrum.coefficients
    parts = mode_sizes(own) ** 2 @ (np.abs(matrix) ** 2).T
    mixed: Complex64[np.ndarray, "V K 3"] = (
        own if len(matrix) == own.shape[1] else np.empty((len(own), len(matrix), 3), np.complex64)
    )
    for start in range(0, len(own), voxels_at_once):
        some = slice(start, start + voxels_at_once)
        mixed[some] = np.einsum("vjc,kj->vkc", own[some], matrix, optimize=True)
    power = mode_sizes(mixed) ** 2
    scale = np.sqrt(np.divide(parts, power, out=np.ones_like(parts), where=power > 0))
    mixed *= scale[:, None].astype(np.float32)
    return mixed


def _scaled_down(voxels: SurfaceVoxels, times: float) -> SurfaceVoxels:
    """Scale a tree down about the origin; moments are in voxels, so they stay."""
    x, y, z = voxels.grid.origin_m
    grid = replace(
        voxels.grid, origin_m=(x / times, y / times, z / times), voxel_size_m=voxels.grid.voxel_size_m / times
    )
    return replace(voxels, grid=grid)
