"""Time from a mesh to all default products over HTTP, with API and worker as `serve` starts them.

Every job's mesh is new, so that no stage is cached. `seconds` are medians from the upload to the last byte downloaded,
`worker_s` is the worker's CPU time. DYNAMICTREE_BENCHMARK_SIZES and DYNAMICTREE_BENCHMARK_RUNS shorten a run.
"""

import os
import statistics

import numpy as np

from benchmarks._machine import BRIEF, machine
from benchmarks._trees import demo_mesh
from benchmarks._whole_service import JobTimes, WholeService, whole_service
from dynamictree.mesh import TriangleMesh

TARGET_S, FIRST_TARGET_S, MEMORY_TARGET_MB = 6.0, 12.0, 1024.0
SIZES = "2000,10000,50000,200000"
RUNS = int(os.environ.get("DYNAMICTREE_BENCHMARK_RUNS", "1" if BRIEF else "5"))
LARGE = 50_000  # [vertices]; larger meshes run three times


def run() -> dict[str, object]:
    sizes = [int(size) for size in os.environ.get("DYNAMICTREE_BENCHMARK_SIZES", SIZES).split(",")]
    demo = demo_mesh()
    with whole_service() as service:
        first = service.run(demo, 0)
        jobs = _jobs(service, demo, RUNS)
        peak_mb = service.peak_mb()
        rows = [_row(service, demo_mesh(size)) for size in sizes]
    return {
        "value": _median(jobs, "wall_s"),
        "unit": "s",
        "target": TARGET_S,
        "first_job_s": round(first.wall_s, 2),
        "first_target_s": FIRST_TARGET_S,
        "stages_s": _stages(jobs),
        "worker_s": _median(jobs, "worker_s"),
        "peak_memory_mb": round(peak_mb),
        "memory_target_mb": MEMORY_TARGET_MB,
        "by_size": rows,
        "exponent": _exponent(rows),
        **machine("torch", "numpy", "numba"),
    }


def _jobs(service: WholeService, mesh: TriangleMesh, runs: int) -> list[JobTimes]:
    return [service.run(mesh, number) for number in range(1, runs + 1)]


def _row(service: WholeService, mesh: TriangleMesh) -> dict[str, object]:
    service.forget_peak()
    jobs = _jobs(service, mesh, RUNS if mesh.num_vertices <= LARGE else min(RUNS, 3))
    return {
        "vertices": mesh.num_vertices,
        "seconds": _median(jobs, "wall_s"),
        "worker_s": _median(jobs, "worker_s"),
        "stages_s": _stages(jobs),
        "peak_memory_mb": round(service.peak_mb()),
    }


def _median(jobs: list[JobTimes], name: str) -> float:
    return round(statistics.median(getattr(job, name) for job in jobs), 2)


def _stages(jobs: list[JobTimes]) -> dict[str, float]:
    return {name: round(statistics.median(job.stages_s[name] for job in jobs), 2) for name in jobs[0].stages_s}


def _exponent(rows: list[dict[str, object]]) -> dict[str, float]:
    """Fit p in worker seconds ~ (n log n)^p: by least squares over all sizes, and between the two largest."""
    vertices = np.array([row["vertices"] for row in rows], np.float64)
    spent = np.log([float(str(row["worker_s"])) for row in rows])
    size = np.log(vertices * np.log(vertices))
    if len(rows) < 2:
        return {}
    return {
        "of_n_log_n": round(float(np.polyfit(size, spent, 1)[0]), 3),
        "of_the_largest_two": round(float((spent[-1] - spent[-2]) / (size[-1] - size[-2])), 3),
    }
