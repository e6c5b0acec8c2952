"""Laws of real trees' motion, checked on the simulator that makes the dataset, for heights of 1 to 35 m, and on what a
model generates of any one tree.

Measurements: lowest frequency of 1,084 laser-scanned trees by height and pull-and-release damping
(TobyDJackson/WindAndTrees_NaturalFrequencies); amplitude by frequency of plants in 818 videos falls as f^-1.07
(fltwr/generative-image-dynamics); displacement grows as U^1.4 to U^2 and saturates.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from jaxtyping import Complex64, Float32, Float64, Int64

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.real_trees import BARE_DAMPING_RATIO, LEAF_DAMPING_RATIO, natural_frequency_hz
from dynamictree.modal.system import modal_system
from dynamictree.spectrum import FPS, NUM_FRAMES, SparseVoxelSpectrum, Wind
from lab.dataset.motion import vertex_spectrum
from lab.dataset.oscillator import damping_ratio, stem_bin
from lab.dataset.sapling import Tree, grow_tree
from lab.dataset.species import SPECIES
from lab.dataset.wind import sway
from lab.training.progress import OnStep

ModelMotion = Callable[[TriangleMesh], Callable[[Wind], SparseVoxelSpectrum]]
"""Of a mesh, a function that generates its motion in a wind."""
HEIGHTS_M = (1.0, 35.0)
SPEEDS_M_S = (1.25, 2.5, 10.0, 20.0)
GUST = 0.3
FREQUENCY_BANDS_HZ = {
    (4, 8): (0.26, 1.24),
    (8, 12): (0.21, 0.55),
    (12, 16): (0.17, 0.36),
    (16, 20): (0.15, 0.31),
    (20, 25): (0.10, 0.26),
    (25, 30): (0.07, 0.18),
    (30, 60): (0.06, 0.14),
}
"""10th and 90th percentile of the lowest natural frequency, by height [m]."""
DAMPING_BAND = (0.03, 0.17)
ORBIT_BAND = (0.05, 0.95)  # minor over major axis: neither a line nor a circle
RESPONSE_BAND = (1.35, 2.0)  # exponent of the displacement with wind speed: "about 1.4 to 2"
MEDIANS = ("damping_ratio", "spectral_slope", "orbit", "response", "response_in_storm")
TIP_SHARE = 0.05  # of the vertices, the highest ones


@dataclass(frozen=True, kw_only=True)
class TreeLaws:
    """Measurements of one tree."""

    species: str
    height_m: float
    frequency_hz: float  # the simulator's, of the longest trunk; of a generated motion the tip's mean by energy
    released_hz: float  # of a pull that is released through the modal response
    damping_ratio: float  # the simulator's; of a generated motion that of a released pull
    spectral_slope: float  # of the amplitude from 1 Hz on: amplitude ~ f^slope
    orbit: float  # minor over major axis of the tip's horizontal motion
    response: float  # exponent of the tip's displacement with wind speed, 1.25 to 2.5 m/s
    response_in_storm: float  # the same from 10 to 20 m/s


def measure_tree(species: str, height_m: float, seed: int) -> TreeLaws:
    """Grow a tree of a height, move it at four speeds, measure."""
    tree = _grown(species, height_m, seed)
    height = float(np.ptp(tree.mesh.vertices[:, 2]))
    foliage = float(SPECIES[species].foliage.kind != "none")
    motions = [_motion(tree, speed, seed) for speed in SPEEDS_M_S]
    response, response_in_storm = _exponents(motions)
    frequencies_hz = np.arange(1, motions[0].shape[1] + 1) * FPS / NUM_FRAMES
    return TreeLaws(
        species=species,
        height_m=height,
        frequency_hz=float(stem_bin(tree.stems[0].length_m, bare=tree.bare).min() * FPS / NUM_FRAMES),
        released_hz=natural_frequency_hz(height, foliage),
        damping_ratio=damping_ratio(bare=tree.bare),
        spectral_slope=_slope(motions[1], frequencies_hz),
        orbit=_orbit(motions[1]),
        response=response,
        response_in_storm=response_in_storm,
    )


def measure_generated(name: str, generate: Callable[[Wind], SparseVoxelSpectrum]) -> TreeLaws:
    """Generate a tree's motion at four speeds, and measure its highest voxels.

    Args:
        name: of the tree.
        generate: gives the spectrum of the tree's motion in a wind, in a period that fits its height.
    """
    spectra = [generate(Wind(speed_m_s=speed, gust=GUST)) for speed in SPEEDS_M_S]
    grid = spectra[1].grid
    top = _highest(grid.centres_m)
    motions = [spectrum.coefficients[top, 1:] for spectrum in spectra]
    response, response_in_storm = _exponents(motions)
    frequencies_hz = spectra[1].frequencies_hz[1:]
    system = modal_system(spectra[1])
    return TreeLaws(
        species=name,
        height_m=grid.height_m,
        frequency_hz=float(np.average(frequencies_hz, weights=(np.abs(motions[1]) ** 2).sum(axis=(0, 2)))),
        released_hz=float(system.omega[0] / (2 * np.pi)),
        damping_ratio=float(np.median(system.damping_ratio)),
        spectral_slope=_slope(motions[1], frequencies_hz),
        orbit=_orbit(motions[1]),
        response=response,
        response_in_storm=response_in_storm,
    )


def measure_trees(
    num_trees: int, *, seed: int = 0, model: ModelMotion | None = None, on_step: OnStep | None = None
) -> Iterator[TreeLaws]:
    """Trees of all species in turn, their heights evenly spaced in the logarithm, as `evaluate_laws` measures them."""
    names = list(SPECIES)
    heights = np.geomspace(*HEIGHTS_M, num_trees)
    for number, height_m in enumerate(heights):
        species = names[number % len(names)]
        if model is None:
            yield measure_tree(species, float(height_m), seed + number)
        else:
            yield measure_generated(species, model(_grown(species, float(height_m), seed + number).mesh))
        if on_step is not None:
            on_step("trees", number + 1, num_trees, 0.0)


def law_shares(trees: list[TreeLaws]) -> dict[str, float]:
    """The share of trees that satisfy each law; NaN where no tree can be judged."""
    with_band = [(tree, band) for tree in trees if (band := frequency_band(tree.height_m)) is not None]
    bare = BARE_DAMPING_RATIO / LEAF_DAMPING_RATIO
    verdicts = {
        "frequency in the band for the height": [_within(t.frequency_hz, band) for t, band in with_band],
        "released pull in the band for the height": [_within(t.released_hz, band) for t, band in with_band],
        "damping in the measured band": [_within(t.damping_ratio, DAMPING_BAND) for t in trees],
        "bare trees less damped": [
            t.damping_ratio < (1 + bare) / 2 * LEAF_DAMPING_RATIO
            for t in trees
            if t.species in SPECIES and SPECIES[t.species].foliage.kind == "none"
        ],
        "energy falls with frequency": [t.spectral_slope < 0 for t in trees],
        "orbit neither line nor circle": [_within(t.orbit, ORBIT_BAND) for t in trees],
        "response U^1.4 to U^2": [_within(t.response, RESPONSE_BAND) for t in trees],
        "response saturates in a storm": [t.response_in_storm < t.response for t in trees],
    }
    return {name: float(np.mean(of_trees)) if of_trees else float("nan") for name, of_trees in verdicts.items()}


def judged(tree: TreeLaws) -> dict[str, bool | None]:
    """Which laws one tree satisfies; None where nothing was measured of real trees of its height."""
    shares = law_shares([tree])
    shares.pop("bare trees less damped")
    return {law: None if np.isnan(share) else bool(share) for law, share in shares.items()}


def evaluate_laws(
    num_trees: int, *, seed: int = 0, model: ModelMotion | None = None, on_step: OnStep | None = None
) -> dict[str, object]:
    """Measure trees of 1 to 35 m; the share that satisfies each law, and every tree's figures.

    Args:
        num_trees: grown for this.
        seed: of the first tree.
        model: gives a mesh's motion, which is measured in place of the simulator's.
        on_step: called after each tree.
    """
    trees = list(measure_trees(num_trees, seed=seed, model=model, on_step=on_step))
    medians = {name: float(np.median([getattr(tree, name) for tree in trees])) for name in MEDIANS}
    return {"laws": law_shares(trees), "medians": medians, "trees": [asdict(tree) for tree in trees]}


def frequency_band(height_m: float) -> tuple[float, float] | None:
    """The measured band of the lowest frequency [Hz]; None where nothing was measured."""
    for (low, high), band in FREQUENCY_BANDS_HZ.items():
        if low <= height_m < high:
            return band
    return None


def _grown(species: str, height_m: float, seed: int) -> Tree:
    rng = np.random.default_rng([seed, round(1000 * height_m)])
    return grow_tree(replace(SPECIES[species], height_m=(height_m, height_m)), rng)


def _within(value: float, band: tuple[float, float]) -> bool:
    return band[0] <= value <= band[1]


def _motion(tree: Tree, speed_m_s: float, seed: int) -> Complex64[np.ndarray, "N J 3"]:
    """Spectrum of the highest vertices without their lean [m]."""
    rng = np.random.default_rng(seed)
    motion = sway(tree, Wind(speed_m_s=speed_m_s, gust=GUST), rng)
    top = _highest(tree.mesh.vertices)
    return vertex_spectrum(motion, tree.mesh.vertices[top], tree.node[top])[:, 1:]


def _highest(positions: Float32[np.ndarray, "N 3"]) -> Int64[np.ndarray, " M"]:
    """Rows of the highest ones, the highest last."""
    return np.argsort(positions[:, 2])[-max(round(TIP_SHARE * len(positions)), 1) :]


def _exponents(motions: Sequence[Complex64[np.ndarray, "N J 3"]]) -> tuple[float, float]:
    """Exponent of the displacement with wind speed between the two lowest speeds, and between the two highest."""
    moved = [float(np.sqrt((np.abs(motion) ** 2).sum(axis=(1, 2)).mean())) for motion in motions]
    exponents = np.diff(np.log(moved)) / np.diff(np.log(SPEEDS_M_S))
    return float(exponents[0]), float(exponents[-1])


def _slope(motion: Complex64[np.ndarray, "N J 3"], frequencies_hz: Float64[np.ndarray, " J"]) -> float:
    amplitude: Float64[np.ndarray, " J"] = np.sqrt((np.abs(motion) ** 2).sum(axis=2).mean(axis=0, dtype=np.float64))
    fast = frequencies_hz > 1
    return float(np.polyfit(np.log(frequencies_hz[fast]), np.log(np.maximum(amplitude[fast], 1e-12)), 1)[0])


def _orbit(motion: Complex64[np.ndarray, "N J 3"]) -> float:
    """Of the highest vertex: square roots of the eigenvalues of the horizontal covariance."""
    tip = motion[-1, :, :2].astype(np.complex128)  # [J, 2]
    covariance = 2 * (tip.conj().T @ tip).real
    minor, major = np.linalg.eigvalsh(covariance)
    return float(np.sqrt(max(minor, 0) / major))
