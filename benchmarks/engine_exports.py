"""Error of each export against the motion's frames, read by third-party tools. The value is the largest error."""

import tempfile
import time
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

from benchmarks._machine import machine
from benchmarks._read_exports import read_product
from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from lab.dataset.sample import make_sample, voxel_spectrum

FORMATS = ("glb", "glb-morph", "usd", "alembic", "vat")


def run() -> dict[str, object]:
    sample = make_sample(7, "round-broadleaf")
    _, spectrum = voxel_spectrum(sample)
    results: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        frames = write_products(sample.mesh, spectrum, ExportParams(formats=("motion",)), Path(folder))["motion"]
        truth = load_file(frames)["displacement"][:100]
        for name in FORMATS:
            began = time.perf_counter()
            options = ExportParams(formats=(name,))
            path = write_products(sample.mesh, spectrum, options, Path(folder))[name]
            seconds = time.perf_counter() - began
            gap = ((read_product(name, path, sample.mesh.vertices)[:100] - truth) ** 2).sum(axis=2)
            results[name] = {
                "max_mm": round(1e3 * float(np.sqrt(gap.max())), 4),
                "rms_mm": round(1e3 * float(np.sqrt(gap.mean())), 4),
                "megabytes": round(path.stat().st_size / 1e6, 2),
                "seconds": round(seconds, 2),
            }
    exact = max(results[name]["max_mm"] for name in FORMATS if name != "glb-morph")  # lacks flutter
    motion_mm = 1e3 * float(np.sqrt((truth**2).sum(axis=2).mean()))
    return {
        "value": exact,
        "unit": "mm",
        "target": 1.0,
        "formats": results,
        "sizes": {"vertices": sample.mesh.num_vertices, "frames": 100, "motion_rms_mm": round(motion_mm, 1)},
        **machine("numpy", "pygltflib", "usd-core", "OpenEXR"),
    }
