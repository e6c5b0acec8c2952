"""Training steps of the small model: the amplitude network, then the denoiser of the whitened residual."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Complex64, Float16, Float32, Int64
from safetensors.torch import load_file, save_file
from torch import Tensor

from dynamictree.diffusion.channels import pack_channels
from dynamictree.models.small.amplitude import AmplitudeNetwork, amplitude_inputs, floor_of, mirror_inputs
from dynamictree.models.small.denoiser import denoise
from dynamictree.models.small.features import NUM_WIND, batch_features, wind_vector
from dynamictree.models.small.foliage import FoliageNetwork
from dynamictree.models.small.mixer import batch_neighbourhoods
from dynamictree.models.small.network import SmallNetwork
from lab.small.examples import Example
from lab.small.whitening import WhiteExample
from lab.training.loss import denoising_loss

MIN_MOTION = 3e-5  # smallest motion whose centroid and lean count [share of the height at drag and gust 1]
CENTROID_WEIGHT = 0.15
LEAN_WEIGHT = 0.5
TREE_SHARE = 0.1
"""Weight of a whole tree's mean error in a bin, which is mostly random gusts and would be overfitted."""
TREES_PER_STEP = 4
VOXELS_PER_TREE = 600  # voxels per tree for the amplitude network


@dataclass(frozen=True, kw_only=True)
class AmplitudeLosses:
    """Squared errors of voxels relative to their tree, plus a share of the tree's own error; see `amplitude_losses`."""

    logarithmic: Float32[Tensor, ""]  # error of ln A against ln |c|
    overall: Float32[Tensor, ""]  # error of ln a
    centroid: Float32[Tensor, ""]  # error of the mean bin
    lean: Float32[Tensor, ""]  # error of the lean, over its square

    def total(self) -> Float32[Tensor, ""]:
        """Return the weighted sum."""
        weighted: Tensor = self.logarithmic + self.overall + CENTROID_WEIGHT * self.centroid + LEAN_WEIGHT * self.lean
        return weighted


def amplitude_losses(
    lean: Float32[Tensor, "R 3"],
    log_amplitude: Float32[Tensor, "R J 3"],
    spectrum: Complex64[Tensor, "R K 3"],
    wind: Float32[Tensor, "R 2"],
    num_trees: int = 1,
) -> AmplitudeLosses:
    """Compute four squared errors of a predicted amplitude and lean. All trees have equally many, consecutive rows.

    In logarithms, every voxel and frequency counts equally; the difference of E ln |c| and ln A is measured afterwards.
    The second error weights the frequencies that carry the motion, since a² = Σ A². The third compares low with high
    frequencies in voxels that move visibly; without it, half of the centroid's accuracy is lost, as measured. Lengths
    are over the height and in the wind's frame; `wind` has ln speed and gust at each row.
    """
    floor, least = floor_of(wind), floor_of(wind, MIN_MOTION)
    power = spectrum[:, 1:].abs().square()  # [R, J, 3]
    guessed_power = (2 * log_amplitude).exp()
    size = (power + floor[:, None, None] ** 2).log() / 2
    total = (power.sum(dim=(1, 2)) + floor**2).log() / 2
    guessed = guessed_power.sum(dim=(1, 2)).log() / 2
    truth = spectrum[:, 0].real
    seen = power.sum(dim=(1, 2)) > least**2
    difference = _mean_bin(guessed_power.sum(dim=2)) - _mean_bin(power.sum(dim=2) + floor[:, None] ** 2)
    return AmplitudeLosses(
        logarithmic=_squared(log_amplitude - size, num_trees),
        overall=_squared(guessed - total, num_trees),
        centroid=_squared(difference * seen, num_trees),
        lean=((lean - truth).square().sum(dim=1) / (truth.square().sum(dim=1) + least**2)).mean(),
    )


def _mean_bin(power: Float32[Tensor, "R J"]) -> Float32[Tensor, " R"]:
    bins = torch.arange(1, power.shape[1] + 1, dtype=power.dtype)
    mean: Tensor = (power * bins).sum(dim=1) / power.sum(dim=1)
    return mean


def _squared(error: Float32[Tensor, "*S"], num_trees: int) -> Float32[Tensor, ""]:
    by_tree = error.view(num_trees, -1, *error.shape[1:])
    of_all = by_tree.mean(dim=1, keepdim=True)
    mean: Tensor = (by_tree - of_all).square().mean() + TREE_SHARE * of_all.square().mean()
    return mean


TREES_PER_BATCH, ROWS_PER_TREE = 32, 96  # batch of the amplitude network
STANDARDISED_ON = 20_000  # number of rows
MIN_DEVIATION = 0.01
FREQUENCIES_PER_TREE = 4
LOW_FREQUENCY_BIAS = 1.0  # k has probability ~ 1 / k: low bins carry the motion, high ones are near noise
HALF_SCALE = 1000.0
"""Spectra over the height are 1e-5 to 0.1; multiplied by this factor they suit float16."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AmplitudeRows:
    """Inputs and targets of voxels drawn from many trees; float16 to save memory."""

    inputs: Float16[Tensor, "R I"]
    wind: Float32[Tensor, "R 2"]
    scaled: Float16[Tensor, "R K 3 2"]  # spectrum over the height times HALF_SCALE

    def __len__(self) -> int:
        return len(self.inputs)

    def spectrum(self, rows: Int64[Tensor, " S"]) -> Complex64[Tensor, "S K 3"]:
        """Return the spectrum divided by the height, in the wind's frame."""
        return torch.view_as_complex(self.scaled[rows].float() / HALF_SCALE)


@torch.no_grad()
def amplitude_rows(foliage: FoliageNetwork, examples: Iterable[Example], rng: np.random.Generator) -> AmplitudeRows:
    """Draw VOXELS_PER_TREE voxels of each tree."""
    inputs, winds, spectra = [], [], []
    for example in examples:
        wind = wind_vector([example.wind])
        with torch.autocast("cpu", torch.bfloat16):
            foliage_values = foliage(example.tree)
        rows = torch.from_numpy(rng.integers(0, len(example.tree.scalars), VOXELS_PER_TREE))
        inputs.append(amplitude_inputs(example.tree, foliage_values, wind)[rows].half())
        winds.append(wind[:, :NUM_WIND].expand(VOXELS_PER_TREE, NUM_WIND))
        spectra.append(torch.view_as_real(example.spectrum[rows] * HALF_SCALE).half())
    return AmplitudeRows(inputs=torch.cat(inputs), wind=torch.cat(winds), scaled=torch.cat(spectra))


def write_rows(rows: AmplitudeRows, path: Path) -> None:
    """Write rows atomically."""
    partial = path.with_suffix(".partial")
    save_file({"inputs": rows.inputs, "wind": rows.wind, "scaled": rows.scaled}, partial)
    partial.rename(path)


def read_rows(paths: Sequence[Path]) -> AmplitudeRows:
    """Read the rows of several files that `write_rows` wrote."""
    stored = [load_file(path) for path in paths]
    inputs, wind, scaled = (torch.cat([one[name] for one in stored]) for name in ("inputs", "wind", "scaled"))
    return AmplitudeRows(inputs=inputs, wind=wind, scaled=scaled)


def standardise(network: AmplitudeNetwork, rows: AmplitudeRows) -> None:
    """Set the mean and deviation by which the network normalises its inputs."""
    some = rows.inputs[:: max(1, len(rows) // STANDARDISED_ON)].float()
    network.mean.copy_(some.mean(dim=0))
    network.deviation.copy_(some.std(dim=0) + MIN_DEVIATION)


def amplitude_step(network: AmplitudeNetwork, rows: AmplitudeRows, rng: np.random.Generator) -> Float32[Tensor, ""]:
    """Return the amplitude network's loss on a batch, equally many rows per tree; half of the batches are mirrored."""
    trees = rng.choice(num_trees := len(rows) // VOXELS_PER_TREE, min(TREES_PER_BATCH, num_trees), replace=False)
    drawn = rng.integers(0, VOXELS_PER_TREE, (len(trees), ROWS_PER_TREE))
    chosen = torch.from_numpy((trees[:, None] * VOXELS_PER_TREE + drawn).ravel())
    inputs, spectrum = rows.inputs[chosen].float(), rows.spectrum(chosen)
    if rng.random() < 0.5:
        inputs, spectrum = mirror_inputs(inputs), spectrum * torch.tensor([1.0, -1.0, 1.0])
    wind = rows.wind[chosen]
    torch.manual_seed(int(rng.integers(2**62)))  # seed of the dropout
    lean, log_amplitude = network(inputs, wind)
    return amplitude_losses(lean.float(), log_amplitude.float(), spectrum, wind, len(trees)).total()


def denoising_step(
    network: SmallNetwork, examples: Sequence[WhiteExample], rng: np.random.Generator, *, trees: int = TREES_PER_STEP
) -> Float32[Tensor, ""]:
    """Return the denoiser's loss on one batch: every tree at some frequencies, each with its own noise level."""
    preset = network.preset
    bins = np.arange(1, preset.num_frequencies)
    chance = bins**-LOW_FREQUENCY_BIAS / (bins**-LOW_FREQUENCY_BIAS).sum()
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    trees = min(trees, len(examples))
    chosen_trees = [examples[index] for index in rng.choice(len(examples), trees, replace=False)]
    clean, sizes, noises, frequencies = [], [], [], []
    for white in chosen_trees:
        chosen = torch.from_numpy(np.sort(rng.choice(bins, FREQUENCIES_PER_TREE, replace=False, p=chance)))
        phase = torch.exp(2j * torch.pi * torch.rand(len(chosen), generator=generator))  # a time shift per bin
        clean.append(pack_channels(white.whitened[:, chosen - 1] * phase[:, None]))
        noise = white.noise.of_bins(chosen - 1)
        noises.append(noise.pool.apply(noise.field(noise.draw(network.common_share[chosen - 1], generator))))
        sizes.append(white.log_amplitude[:, chosen - 1])
        frequencies.append(chosen)
    nodes = batch_features([white.nodes for white in chosen_trees])
    wind, signal = wind_vector([white.wind for white in chosen_trees]), torch.cat(clean)
    low, high = np.log(preset.sigma_min), np.log(preset.sigma_max)
    sigma = (low + (high - low) * torch.rand(trees, FREQUENCIES_PER_TREE, generator=generator)).exp()
    condition = network.denoiser.condition(
        nodes,
        wind,
        frequency=torch.stack(frequencies),
        log_amplitude=torch.cat(sizes),
        neighbourhood=batch_neighbourhoods([white.neighbourhood for white in chosen_trees]),
    )
    at_node = sigma[condition.tree_of_node][..., None]
    denoised = denoise(network.denoiser, signal + at_node * torch.cat(noises), sigma, condition)
    return denoising_loss(denoised, signal, at_node).mean()
