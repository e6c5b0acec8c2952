"""Compare tall trees whose period depends on height with the simulator: size and place of the motion by frequency.

The same trees with the period of 4.17 s, whose lowest bin is at 0.24 Hz, are listed for comparison.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex64, Float64

from benchmarks._machine import machine
from dynamictree import method
from dynamictree.models.periods import PERIOD_S, period_by_height
from dynamictree.requests import Wind
from dynamictree.spectrum import NUM_FREQUENCIES
from lab.dataset.motion import vertex_spectrum
from lab.dataset.sample import surface_average
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from lab.dataset.wind import sway

TREES = (
    ("round-broadleaf", 9.0),
    ("weeping", 13.0),
    ("round-broadleaf", 20.0),
    ("conical-conifer", 21.0),
    ("conical-conifer", 27.0),
    ("weeping", 26.0),
)
BANDS_HZ = ((0.01, 0.15), (0.15, 0.3), (0.3, 0.6), (0.6, 1.2), (1.2, 2.4), (2.4, 3.8))
WIND = Wind(speed_m_s=5.0, direction_deg=30.0, gust=0.3)


def run() -> dict[str, object]:
    rows = [_compare(species, height_m, seed) for seed, (species, height_m) in enumerate(TREES)]
    correlations = [band["correlation"] for row in rows for band in row["by_height"]]
    ratios = [abs(np.log(band["model_mm"] / band["simulator_mm"])) for row in rows for band in row["by_height"]]
    return {
        "value": round(float(np.median(correlations)), 3),
        "unit": "correlation of ln amplitude over voxels, median of all bands and trees",
        "median_size_factor": round(float(np.exp(np.median(ratios))), 3),
        "trees": rows,
        **machine("numpy", "torch"),
    }


def _compare(species: str, height_m: float, seed: int) -> dict[str, object]:
    tree = grow_tree(replace(SPECIES[species], height_m=(height_m, height_m)), np.random.default_rng([5, seed]))
    voxels = method.voxelize(tree.mesh)
    period_s = period_by_height(voxels)
    times = round(period_s / PERIOD_S)
    motion = sway(tree, WIND, np.random.default_rng(1), times=times)
    own = vertex_spectrum(motion, tree.mesh.vertices, tree.node, NUM_FREQUENCIES * times)
    weights = surface_average(tree.mesh, voxels.grid).astype(np.float32)
    parts = np.ascontiguousarray(own).reshape(len(own), -1).view(np.float32)
    truth = np.ascontiguousarray(weights @ parts).view(np.complex64).reshape(len(voxels.grid), -1, 3)
    true_hz = np.arange(truth.shape[1]) / period_s
    rows: dict[str, object] = {"species": species, "height_m": round(tree.mesh.height_m, 1), "period_s": period_s}
    for name, wanted_s in (("by_height", None), ("4.17 s", PERIOD_S)):
        spectrum = method.generate(voxels, wind=WIND, seed=2, period_s=wanted_s)
        bands = [
            (band, _in_band(spectrum.coefficients, spectrum.frequencies_hz, band), _in_band(truth, true_hz, band))
            for band in BANDS_HZ
        ]
        rows[name] = [_band(band, model, simulator) for band, model, simulator in bands if model.any()]
    return rows


def _in_band(
    coefficients: Complex64[np.ndarray, "V K 3"], frequency_hz: Float64[np.ndarray, " K"], band: tuple[float, float]
) -> Float64[np.ndarray, " V"]:
    inside = (frequency_hz >= band[0]) & (frequency_hz < band[1])
    return np.sqrt((np.abs(coefficients[:, inside]) ** 2).sum(axis=(1, 2), dtype=np.float64))


def _band(
    band: tuple[float, float], model: Float64[np.ndarray, " V"], simulator: Float64[np.ndarray, " V"]
) -> dict[str, object]:
    return {
        "band_hz": band,
        "model_mm": round(1e3 * float(np.sqrt((model**2).mean())), 2),
        "simulator_mm": round(1e3 * float(np.sqrt((simulator**2).mean())), 2),
        "correlation": round(float(np.corrcoef(np.log(model + 1e-6), np.log(simulator + 1e-6))[0, 1]), 3),
    }
