"""Gusts through crowns of the simulator and of the model: lag per metre downwind, and kurtosis in time.

Trees as `dynamictree evaluate --laws` grows them, 8 m/s, gust 0.3; crowns at least WIDE_M wide have a lag.
`DYNAMICTREE_BENCHMARK_TREES` sets the number of trees (84); the model moves every sixth.
"""

import os
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64

from benchmarks._machine import BRIEF, machine
from dynamictree import method
from dynamictree.spectrum import Wind, to_motion
from lab.dataset.motion import vertex_spectrum
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from lab.dataset.wind import sway
from lab.evaluation.laws import HEIGHTS_M, MAX_POINTS
from lab.evaluation.motion_statistics import Motion, velocity, without_trunk_motion

WIND = Wind(speed_m_s=8.0, gust=0.3)
WIDE_M = 4.0
SLABS = 6  # slabs of a crown across the wind
LAGS_S_M = np.linspace(-0.5, 0.5, 201)
TOLERANCE = 0.3  # share of 1 / U


def run() -> dict[str, object]:
    trees = 6 if BRIEF else int(os.environ.get("DYNAMICTREE_BENCHMARK_TREES", "84"))
    rows: dict[str, list[tuple[float, float]]] = {"simulator": [], "model": []}
    for number, height_m in enumerate(np.geomspace(*HEIGHTS_M, trees)):
        species = replace(list(SPECIES.values())[number % len(SPECIES)], height_m=(float(height_m), float(height_m)))
        tree = grow_tree(species, np.random.default_rng([number, round(1000 * float(height_m))]))
        places = tree.mesh.vertices
        spectrum = vertex_spectrum(sway(tree, WIND, np.random.default_rng(number)), places, tree.node)
        rows["simulator"].append(_statistics(places, spectrum, 100 / 24))
        if number % 6 == 0:
            voxels = method.voxelize(tree.mesh)
            drawn = method.generate(voxels, wind=WIND, seed=0)
            period_s = 1 / float(drawn.frequencies_hz[1])
            rows["model"].append(_statistics(drawn.grid.centres_m, drawn.coefficients, period_s))
    return {"unit": "s/m", "wanted": 1 / WIND.speed_m_s, **{who: _summary(of) for who, of in rows.items()}, **machine()}


def _summary(rows: list[tuple[float, float]]) -> dict[str, float]:
    lags, kurtoses = np.array(rows).T
    lags = lags[~np.isnan(lags)] * WIND.speed_m_s
    return {
        "trees": len(rows),
        "wide": len(lags),
        "lag_s_m": float(np.median(lags)) / WIND.speed_m_s,
        "within_30_percent": float((np.abs(lags - 1) <= TOLERANCE).mean()),
        "kurtosis": float(np.median(kurtoses)),
    }


def _statistics(places: Float32[np.ndarray, "N 3"], spectrum: np.ndarray, period_s: float) -> tuple[float, float]:
    some = np.random.default_rng(0).permutation(len(places))[:MAX_POINTS]
    moving = spectrum[some].copy()
    moving[:, 0] = 0
    motion = to_motion(moving, 2 * moving.shape[1]).astype(np.float64)
    if np.ptp(places[some, 0]) < WIDE_M:
        return float("nan"), kurtosis(motion)
    return gust_lag(places[some, 0], without_trunk_motion(places[some], motion), period_s), kurtosis(motion)


def kurtosis(motion: Motion) -> float:
    """Return the median over places of the velocity's kurtosis in time: 3 if normal, more in gusts."""
    squared = velocity(motion) ** 2
    size = squared.mean(axis=0)
    return float(np.median((squared**2).mean(axis=0)[size > 0] / size[size > 0] ** 2))


def gust_lag(downwind_m: Float32[np.ndarray, " N"], motion: Motion, period_s: float) -> float:
    """Return the delay of gusts per metre downwind [s/m].

    It is the lag that maximizes the sum of the slabs' envelopes; an envelope is the mean speed in a slab.
    """
    edges = np.quantile(downwind_m, np.linspace(0, 1, SLABS + 1))
    slab = np.searchsorted(edges[1:-1], downwind_m)
    speed = np.sqrt((velocity(motion) ** 2).sum(axis=2))
    envelope = np.stack([speed[:, slab == one].mean(axis=1) for one in range(SLABS)])
    hat = np.fft.rfft(envelope / envelope.mean(axis=1, keepdims=True), axis=1)
    omega: Float64[np.ndarray, " W"] = 2 * np.pi * np.arange(hat.shape[1]) / period_s
    slow = (omega > 0) & (omega < 2 * np.pi)  # gusts of a second and longer
    middle = np.array([downwind_m[slab == one].mean() for one in range(SLABS)])
    turns = np.exp(1j * LAGS_S_M[:, None, None] * middle[:, None] * omega[slow])
    return float(LAGS_S_M[(np.abs((turns * hat[:, slow]).sum(axis=1)) ** 2).sum(axis=1).argmax()])
