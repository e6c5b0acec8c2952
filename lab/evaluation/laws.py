"""Laws of real trees' motion, measured on motions of the simulator for heights of 1 to 35 m, and on a model's motions
of any one tree. No parameters are read: frequency and damping are those of a simulated ring-down.

Measurements: lowest frequency of 58 broadleaf trees of 12 to 56 m, and below 12 m that of finite-element models of
scanned trees; pull-and-release damping (all TobyDJackson/WindAndTrees_NaturalFrequencies); amplitude by frequency of
plants in 818 videos falls as f^-1.07 (fltwr/generative-image-dynamics); displacement grows as U^1.4 to U^2 and
saturates.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from jaxtyping import Complex64, Float32, Float64, Int64

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.real_trees import height_law_hz
from dynamictree.spectrum import FPS, NUM_FRAMES, SparseVoxelSpectrum, Wind, to_motion
from lab.dataset.motion import vertex_spectrum
from lab.dataset.sapling import Tree, grow_tree
from lab.dataset.species import SPECIES
from lab.dataset.wind import free_motion, sway
from lab.evaluation.motion_statistics import correlation, effective_shapes, fast_share, velocity, without_trunk_motion
from lab.training.progress import OnStep

ModelMotion = Callable[[TriangleMesh], Callable[[Wind], SparseVoxelSpectrum]]
"""Maps a mesh to a function that generates its motion in a wind."""
HEIGHTS_M = (1.0, 35.0)
SPEEDS_M_S = (1.25, 2.5, 3.0, 8.0, 10.0, 20.0)
GUST = 0.3
MODEL_BANDS_HZ = {(4, 8): (0.26, 1.24), (8, 12): (0.21, 0.55)}
"""10th and 90th percentile of the lowest frequency of finite-element models, by height [m]."""
MEASURED_FROM_M, MEASURED_TO_M = 12.0, 56.0
MEASURED_SPREAD = (0.73, 1.27)
"""10th and 90th percentile of the measured frequencies over the law of height."""
DAMPING_BAND = (0.03, 0.17)
ORBIT_BAND = (0.05, 0.95)  # minor over major axis; excludes lines and circles
RESPONSE_BAND = (1.35, 2.0)  # exponent of the displacement with wind speed: "about 1.4 to 2"
LEAST_SHAPES, LARGEST_CORRELATION, LEAST_FAST_SHARE = 12, 0.85, 0.15
"""Targets, not measurements: version 4 had 13 shapes, a correlation of 0.93, and a share of 0.07."""
MEDIANS = (
    "damping_ratio", "spectral_slope", "orbit", "response", "response_in_storm", "shapes", "correlation",
    "fast_share_slow", "fast_share",
)  # fmt: skip
RING_DOWN_END = 0.1  # share of the first peak at which the measurement of a ring-down ends
TIP_SHARE = 0.05  # share of the vertices, the highest ones
MAX_POINTS = 2000  # largest number of places whose motions are compared


@dataclass(frozen=True, kw_only=True)
class TreeLaws:
    """Measurements of one tree."""

    species: str
    height_m: float
    frequency_hz: float  # frequency of the ring-down; for a generated motion, the tip's energy-weighted mean
    damping_ratio: float  # ratio of the simulated ring-down; NaN for a generated motion
    spectral_slope: float  # exponent of the tip's amplitude from 1 Hz on: amplitude ~ f^slope
    orbit: float  # minor over major axis of the tip's horizontal motion
    response: float  # exponent of the tip's displacement with wind speed, 1.25 to 2.5 m/s
    response_in_storm: float  # exponent from 10 to 20 m/s
    shapes: float  # effective number of shapes in the velocity off the trunk, at 8 m/s
    correlation: float  # correlation of the motions at 3 and at 8 m/s
    fast_share_slow: float  # share of the velocity's energy above 2 Hz, at 3 m/s
    fast_share: float  # share at 8 m/s


def measure_tree(species: str, height_m: float, seed: int) -> TreeLaws:
    """Grow a tree of this height, release it in still air, simulate it at all speeds, and measure."""
    tree = _grown(species, height_m, seed)
    frequency_hz, damping_ratio = fit_ring_down(free_motion(tree))
    places = tree.mesh.vertices
    motions = []
    for speed in SPEEDS_M_S:
        motion = sway(tree, Wind(speed_m_s=speed, gust=GUST), np.random.default_rng(seed))
        motions.append(vertex_spectrum(motion, places, tree.node))
    return TreeLaws(
        species=species,
        height_m=float(np.ptp(places[:, 2])),
        frequency_hz=frequency_hz,
        damping_ratio=damping_ratio,
        **_of_motions(places, motions, np.arange(motions[0].shape[1]) * FPS / NUM_FRAMES),
    )


def measure_generated(name: str, generate: Callable[[Wind], SparseVoxelSpectrum]) -> TreeLaws:
    """Generate a tree's motion at all speeds, with a period that fits its height, and measure it."""
    spectra = [generate(Wind(speed_m_s=speed, gust=GUST)) for speed in SPEEDS_M_S]
    places, frequencies_hz = spectra[0].grid.centres_m, spectra[0].frequencies_hz
    motions = [spectrum.coefficients for spectrum in spectra]
    power = (np.abs(motions[1][_highest(places), 1:]) ** 2).sum(axis=(0, 2))
    return TreeLaws(
        species=name,
        height_m=spectra[0].grid.height_m,
        frequency_hz=float(np.average(frequencies_hz[1:], weights=power)),
        damping_ratio=float("nan"),
        **_of_motions(places, motions, frequencies_hz),
    )


def _of_motions(
    places: Float32[np.ndarray, "N 3"],
    motions: Sequence[Complex64[np.ndarray, "N K 3"]],
    frequencies_hz: Float64[np.ndarray, " K"],
) -> dict[str, float]:
    """Measure the spectra at SPEEDS_M_S."""
    top = _highest(places)
    tips = [motion[top, 1:] for motion in motions]
    response, response_in_storm = _exponents(tips)
    some = np.random.default_rng(0).permutation(len(places))[:MAX_POINTS]
    num_frames = 2 * motions[0].shape[1]
    slow, fast = (to_motion(_lean_removed(motions[at][some]), num_frames).astype(np.float64) for at in (2, 3))
    frame_s = 1 / float(frequencies_hz[1]) / num_frames
    return {
        "spectral_slope": _slope(tips[1], frequencies_hz[1:]),
        "orbit": _orbit(tips[1]),
        "response": response,
        "response_in_storm": response_in_storm,
        "shapes": effective_shapes(velocity(without_trunk_motion(places[some], fast))),
        "correlation": correlation(slow, fast),
        "fast_share_slow": fast_share(slow, frame_s),
        "fast_share": fast_share(fast, frame_s),
    }


def fit_ring_down(series: Float64[np.ndarray, " T"]) -> tuple[float, float]:
    """Measure frequency [Hz] and damping ratio of a ring-down, from its zero crossings and the decay of its peaks."""
    at = np.flatnonzero(np.diff(np.signbit(series)))
    crossings = at + series[at] / (series[at] - series[at + 1])
    peaks = np.array([part.max() for part in np.split(np.abs(series), at + 1)[1:-1]])  # one peak between two crossings
    small = np.flatnonzero(peaks < RING_DOWN_END * peaks[0])
    last = max(int(small[0]), 2) if len(small) else len(peaks)
    frequency_hz = FPS * last / (2 * (crossings[last] - crossings[0]))
    decrement = -np.polyfit(np.arange(last), np.log(peaks[:last]), 1)[0]
    return float(frequency_hz), float(decrement / np.hypot(np.pi, decrement))


def measure_trees(
    num_trees: int, *, seed: int = 0, model: ModelMotion | None = None, on_step: OnStep | None = None
) -> Iterator[TreeLaws]:
    """Measure trees for `evaluate_laws`: all species in turn, heights evenly spaced in the logarithm."""
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
    """Return the share of trees that satisfy each law; NaN if no tree can be judged."""
    measured = [tree for tree in trees if MEASURED_FROM_M <= tree.height_m <= MEASURED_TO_M]
    modelled = [(tree, band) for tree in trees if (band := model_band(tree.height_m)) is not None]
    rung = [tree for tree in trees if not np.isnan(tree.damping_ratio)]
    leafy = [tree.damping_ratio for tree in rung if not _is_bare(tree)]
    verdicts = {
        "frequency of measured trees": [
            _within(tree.frequency_hz / float(height_law_hz(tree.height_m)), MEASURED_SPREAD) for tree in measured
        ],
        "frequency of finite-element models": [_within(tree.frequency_hz, band) for tree, band in modelled],
        "damping of measured trees": [_within(tree.damping_ratio, DAMPING_BAND) for tree in rung],
        "bare trees less damped": [tree.damping_ratio < min(leafy, default=np.inf) for tree in rung if _is_bare(tree)],
        "energy falls with frequency": [t.spectral_slope < 0 for t in trees],
        "orbit neither line nor circle": [_within(t.orbit, ORBIT_BAND) for t in trees],
        "response U^1.4 to U^2": [_within(t.response, RESPONSE_BAND) for t in trees],
        "response saturates in a storm": [t.response_in_storm < t.response for t in trees],
        "branches move on their own": [t.shapes >= LEAST_SHAPES for t in trees],
        "speed changes the shape": [t.correlation <= LARGEST_CORRELATION for t in trees],
        "leaves flutter in a fresh breeze": [t.fast_share >= LEAST_FAST_SHARE for t in trees if not _is_bare(t)],
        "flutter sets in with the speed": [t.fast_share >= 2 * t.fast_share_slow for t in trees if not _is_bare(t)],
    }
    return {name: float(np.mean(of_trees)) if of_trees else float("nan") for name, of_trees in verdicts.items()}


def satisfied_laws(tree: TreeLaws) -> dict[str, bool | None]:
    """Return which laws one tree satisfies; None if there are no measurements of real trees of its height."""
    shares = law_shares([tree])
    shares.pop("bare trees less damped")
    return {law: None if np.isnan(share) else bool(share) for law, share in shares.items()}


def evaluate_laws(
    num_trees: int, *, seed: int = 0, model: ModelMotion | None = None, on_step: OnStep | None = None
) -> dict[str, object]:
    """Measure trees of 1 to 35 m; return the share that satisfies each law, and every tree's figures.

    The motions are those that `model` generates of a tree's mesh; by default the simulator's.
    """
    trees = list(measure_trees(num_trees, seed=seed, model=model, on_step=on_step))
    measured = {name: [value for tree in trees if not np.isnan(value := getattr(tree, name))] for name in MEDIANS}
    medians = {name: float(np.median(values or [np.nan])) for name, values in measured.items()}
    return {"laws": law_shares(trees), "medians": medians, "trees": [asdict(tree) for tree in trees]}


def model_band(height_m: float) -> tuple[float, float] | None:
    """Return the band of the lowest frequency of finite-element models [Hz]; None from 12 m on and below 4 m."""
    for (low, high), band in MODEL_BANDS_HZ.items():
        if low <= height_m < high:
            return band
    return None


def _is_bare(tree: TreeLaws) -> bool:
    return tree.species in SPECIES and SPECIES[tree.species].foliage.kind == "none"


def _lean_removed(spectrum: Complex64[np.ndarray, "N K 3"]) -> Complex64[np.ndarray, "N K 3"]:
    moving = spectrum.copy()
    moving[:, 0] = 0
    return moving


def _grown(species: str, height_m: float, seed: int) -> Tree:
    rng = np.random.default_rng([seed, round(1000 * height_m)])
    return grow_tree(replace(SPECIES[species], height_m=(height_m, height_m)), rng)


def _within(value: float, band: tuple[float, float]) -> bool:
    return band[0] <= value <= band[1]


def _highest(positions: Float32[np.ndarray, "N 3"]) -> Int64[np.ndarray, " M"]:
    """Return the rows of the highest points, the highest last."""
    return np.argsort(positions[:, 2])[-max(round(TIP_SHARE * len(positions)), 1) :]


def _exponents(motions: Sequence[Complex64[np.ndarray, "N J 3"]]) -> tuple[float, float]:
    """Return the exponent of displacement with wind speed between the two lowest and between the two highest speeds."""
    moved = [float(np.sqrt((np.abs(motion) ** 2).sum(axis=(1, 2)).mean())) for motion in motions]
    exponents = np.diff(np.log(moved)) / np.diff(np.log(SPEEDS_M_S))  # the first and the last step double the speed
    return float(exponents[0]), float(exponents[-1])


def _slope(motion: Complex64[np.ndarray, "N J 3"], frequencies_hz: Float64[np.ndarray, " J"]) -> float:
    amplitude: Float64[np.ndarray, " J"] = np.sqrt((np.abs(motion) ** 2).sum(axis=2).mean(axis=0, dtype=np.float64))
    fast = frequencies_hz > 1
    return float(np.polyfit(np.log(frequencies_hz[fast]), np.log(np.maximum(amplitude[fast], 1e-12)), 1)[0])


def _orbit(motion: Complex64[np.ndarray, "N J 3"]) -> float:
    """Return minor over major axis of the highest vertex's motion: roots of its horizontal covariance's eigenvalues."""
    tip = motion[-1, :, :2].astype(np.complex128)  # [J, 2]
    covariance = 2 * (tip.conj().T @ tip).real
    minor, major = np.linalg.eigvalsh(covariance)
    return float(np.sqrt(max(minor, 0) / major))
