"""Trees a second that `dataset generate` bakes: growing, moving, filtering, voxel spectra, writing."""

import itertools
import statistics
import tempfile
import time
from pathlib import Path

from benchmarks._machine import machine
from lab.dataset.generate import Recipe, generate

TARGET = 5.0  # trees a second on two cores: 8,786 trees in half an hour
WORKERS = 2
RECIPE = Recipe(trees=96, trees_per_shard=4)


def run() -> dict[str, object]:
    marks: list[tuple[float, int]] = []
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        manifest = generate(
            RECIPE,
            Path(folder),
            workers=WORKERS,
            on_shard=lambda done, total: marks.append((time.perf_counter() - start, done)),
        )
    warm = marks[2 * WORKERS :]  # the first shards wait for the processes' imports
    (first, begun), (last, done) = warm[0], warm[-1]
    gaps = [(after - before) / RECIPE.trees_per_shard for (before, _), (after, _) in itertools.pairwise(warm)]
    trees, size = manifest["trees"], manifest["bytes"]
    assert isinstance(trees, int)
    assert isinstance(size, int)
    return {
        "value": round((done - begun) / (last - first), 2),
        "unit": "trees/s",
        "target": TARGET,
        "with_start_up": round(trees / last, 2),
        "median_s_a_tree": round(statistics.median(gaps), 4),
        "p90_s_a_tree": round(statistics.quantiles(gaps, n=10)[-1], 4),
        "sizes": {
            "trees": trees,
            "mean_vertices": manifest["mean_vertices"],
            "frames": 100,
            "resolution": list(RECIPE.resolutions),
            "mb_a_tree": round(size / trees / 1e6, 2),
        },
        "workers": WORKERS,
        **machine("numpy", "scipy", "numba", "safetensors"),
    }
