"""Steps of the sampler against quality, by voxel, on five trees, three of them of species that no training saw."""

from time import perf_counter

import numpy as np

from benchmarks._machine import machine
from dynamictree.models import load_model
from dynamictree.voxel.graph import voxel_graph
from lab.dataset.sample import make_sample, voxel_spectrum
from lab.evaluation.metrics import log_amplitude_agreement, roughness

TREES = ((3, "palm"), (5, "weeping"), (7, "pine"), (11, "maple"), (13, "round-broadleaf"))
STEPS = (2, 3, 4, 8, 16)


def run() -> dict[str, object]:
    model = load_model("small")
    rows: dict[int, list[dict[str, float]]] = {steps: [] for steps in STEPS}
    for seed, species in TREES:
        sample = make_sample(seed, species)
        voxels, spectrum = voxel_spectrum(sample)
        truth = spectrum.coefficients
        edges = np.stack(voxel_graph(voxels.grid).nonzero(), axis=1)
        height_m = sample.mesh.height_m
        for steps in STEPS:
            began = perf_counter()
            guess = model.generate(voxels, wind=sample.wind, seed=0, num_steps=steps).coefficients
            seconds = perf_counter() - began
            correlation, rmse = log_amplitude_agreement(guess, truth, height_m)
            rows[steps].append(
                {
                    "log_amplitude_rmse": rmse,
                    "log_amplitude_correlation": correlation,
                    "roughness_ratio": roughness(guess, edges) / roughness(truth, edges),
                    "seconds": seconds,
                }
            )
    return {
        "value": {
            steps: {key: round(float(np.mean([row[key] for row in of])), 3) for key in of[0]}
            for steps, of in rows.items()
        },
        "unit": "see keys",
        "sizes": {"trees": len(TREES)},
        **machine("torch", "numpy"),
    }
