"""Accuracy of the representation by resolution, number of frequencies, and method of devoxelization.

No network is involved, so no training is needed; the paper trains one model per row of its tables. Sizes: two trees of
unseen species, by vertex.
"""

import numpy as np

from benchmarks._machine import machine
from dynamictree import method
from dynamictree.devoxelize.nearest import nearest_rows
from dynamictree.mesh import edges_of
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import surface_average, voxelize
from lab.dataset.motion import vertex_spectrum
from lab.dataset.sample import make_sample
from lab.evaluation.metrics import centroid_correlation, edge_stretch, log_amplitude_agreement, roughness

TREES = ((2, "weeping"), (3, "palm"))
ALL = 24  # number of frequencies
RESOLUTIONS = (32, 64, 128, 256)
COUNTS = (4, 8, 16, 24)
COUNTS_AT = (128, "rig")  # cases in which numbers of frequencies are compared; elsewhere K = 16


def run() -> dict[str, object]:
    tables: dict[str, list[dict[str, float]]] = {}
    for seed, species in TREES:
        sample = make_sample(seed, species)
        truth = vertex_spectrum(sample.motion, sample.mesh.vertices, sample.node, ALL)
        edges = edges_of(sample.mesh.faces)
        for resolution in RESOLUTIONS:
            grid = voxelize(sample.mesh, resolution).grid
            average = surface_average(sample.mesh, grid)
            rows, (corners, weights) = nearest_rows(grid, sample.mesh.vertices), _trilinear(grid, sample.mesh.vertices)
            for way in ("nearest", "trilinear", "rig"):
                for count in COUNTS if (resolution, way) == COUNTS_AT else (16,):
                    truncated = truth[:, :count]
                    flat = truncated.reshape(len(truncated), -1).view(np.float32)
                    voxels = np.ascontiguousarray(average.astype(np.float32) @ flat).view(np.complex64)
                    voxels = voxels.reshape(-1, count, 3)
                    if way == "rig":
                        back = method.devoxelize(SparseVoxelSpectrum(grid=grid, coefficients=voxels), sample.mesh)
                    else:
                        around = (voxels[corners] * weights[:, :, None, None]).sum(axis=1)
                        back = around if way == "trilinear" else voxels[rows]
                    name = f"{resolution}, {way}, K={count}"
                    tables.setdefault(name, []).append(_row(back, truth, sample.mesh.vertices, edges))
    return {
        "value": {
            name: {key: round(float(np.mean([row[key] for row in rows])), 4) for key in rows[0]}
            for name, rows in tables.items()
        },
        "unit": "see keys",
        "sizes": {"trees": len(TREES), "frequencies": ALL},
        **machine("numpy"),
    }


def _trilinear(grid: VoxelGrid, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and weights of the eight surrounding voxels; only occupied ones have weight, [N, 8]."""
    place = (points.astype(np.float64) - grid.origin_m) / grid.voxel_size_m - 0.5
    low = np.floor(place).astype(np.int32)
    share = place - low
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(8, 3)
    rows = np.stack([grid.rows_of((low + corner).astype(np.int32)) for corner in corners], axis=1)  # [N, 8]
    weights = np.prod(np.where(corners, share[:, None], 1 - share[:, None]), axis=2) * (rows >= 0)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.maximum(rows, 0), weights.astype(np.float32)


def _row(back: np.ndarray, truth: np.ndarray, vertices: np.ndarray, edges: np.ndarray) -> dict[str, float]:
    whole = np.zeros_like(truth)
    whole[:, : back.shape[1]] = back
    height_m = float(np.ptp(vertices[:, 2]))
    correlation, rmse = log_amplitude_agreement(whole, truth, height_m)
    error = np.sqrt((np.abs(whole - truth)[:, 1:] ** 2).sum() / (np.abs(truth)[:, 1:] ** 2).sum())
    return {
        "relative_error": float(error),
        "log_amplitude_correlation": correlation,
        "log_amplitude_rmse": rmse,
        "centroid_correlation": centroid_correlation(whole, truth),
        "roughness_ratio": roughness(whole, edges) / roughness(truth, edges),
        "stretch_p99": edge_stretch(back, vertices, edges)[1],
    }
