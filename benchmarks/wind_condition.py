"""Effect of wind on a generated motion, compared to the truth: size by speed and gust, and direction of the lean."""

import numpy as np

from benchmarks._machine import machine
from dynamictree.mesh import TriangleMesh
from dynamictree.models import load_model
from dynamictree.spectrum import Wind
from lab.dataset.sample import make_sample, voxel_spectrum
from lab.evaluation.metrics import amplitude

SEED, SPECIES = 2, "weeping"
WINDS = (
    *(Wind(speed_m_s=speed, direction_deg=60.0, gust=0.3) for speed in (2.0, 4.0, 7.0, 10.0)),
    Wind(speed_m_s=4.0, direction_deg=60.0, gust=0.15),
    Wind(speed_m_s=4.0, direction_deg=200.0, gust=0.3),
)


def run() -> dict[str, object]:
    model = load_model("small")
    rows = []
    for wind in WINDS:
        sample = make_sample(SEED, SPECIES, wind=wind)
        voxels, truth = voxel_spectrum(sample)
        guess = model.generate(voxels, wind=wind, seed=0).coefficients
        rows.append(
            {
                "speed_m_s": wind.speed_m_s,
                "gust": wind.gust,
                "direction_deg": wind.direction_deg,
                **{f"model_{name}": value for name, value in _measure(guess, sample.mesh).items()},
                **{f"truth_{name}": value for name, value in _measure(truth.coefficients, sample.mesh).items()},
            }
        )
    return {
        "value": rows,
        "unit": "share of the height; degrees",
        "sizes": {"voxels": len(voxels.grid), "species": SPECIES},
        **machine("torch", "numpy"),
    }


def _measure(coefficients: np.ndarray, mesh: TriangleMesh) -> dict[str, float]:
    lean = coefficients[:, 0].real.mean(axis=0)
    return {
        "amplitude": round(float(amplitude(coefficients).mean() / mesh.height_m), 5),
        "lean": round(float(np.hypot(*lean[:2]) / mesh.height_m), 5),
        "lean_direction_deg": round(float(np.rad2deg(np.arctan2(lean[1], lean[0])) % 360), 1),
    }
