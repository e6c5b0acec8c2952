"""Summaries of file contents, shared by `dynamictree info` and the service's metadata."""

from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32

from dynamictree.mesh import TriangleMesh
from dynamictree.plant.capture import Capture, moving_part
from dynamictree.plant.choice import MOST_LISTED, part_names
from dynamictree.plant.trees.of_mesh import mesh_points
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid


def describe_mesh(mesh: TriangleMesh) -> dict[str, Any]:
    """Summarise a mesh: counts, bounds [m] and how the source's axes and units were read."""
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
    return {
        "num_vertices": mesh.num_vertices,
        "num_faces": mesh.num_faces,
        "num_still_faces": 0 if mesh.still_faces is None else int(mesh.still_faces.sum()),
        "still_parts": [asdict(part) for part in mesh.parts.still],
        "part_names": ", ".join(part_names(mesh)[:MOST_LISTED]),
        "num_materials": len(mesh.look.materials),
        "extent_m": (high - low).round(4).tolist(),
        "low_m": low.round(4).tolist(),
        "source_up_axis": mesh.source.up_axis,
        "source_up_confidence": mesh.source.up_confidence,
        "source_scale": mesh.source.scale,
        "source_offset": list(mesh.source.offset),
        "height_m": round(mesh.height_m, 4),
        "trees": describe_trees(*mesh_points(mesh)),
        "warnings": [asdict(warning) for warning in mesh.warnings],
    }


def describe_capture(capture: Capture) -> dict[str, Any]:
    """Summarise a cloud: counts, bounds [m] and how the source's axes and units were read."""
    cloud = capture.cloud
    sizes = np.bincount(np.zeros(0, np.uint8) if capture.part_of is None else capture.part_of, minlength=1)[1:]
    low, high = cloud.means.min(axis=0).astype(np.float64), cloud.means.max(axis=0).astype(np.float64)
    return {
        "num_gaussians": cloud.num_gaussians,
        "sh_degree": cloud.sh_degree,
        "num_movable": int(moving_part(capture).sum()),
        "still_parts": [
            asdict(part) | {"num_gaussians": int(size)} for part, size in zip(capture.still_parts, sizes, strict=True)
        ],
        "extent_m": (high - low).round(4).tolist(),
        "low_m": low.round(4).tolist(),
        "source_up_axis": cloud.source.up_axis,
        "source_scale": cloud.source.scale,
        "source_offset": list(cloud.source.offset),
        "height_m": round(float(high[2] - low[2]), 4),
        "trees": describe_trees(cloud.means, capture.tree),
        "warnings": [asdict(warning) for warning in capture.warnings],
    }


def describe_trees(
    points: Float32[np.ndarray, "P 3"], tree: Int32[np.ndarray, " P"] | None
) -> list[dict[str, int | float]]:
    """Summarise the trees of points: number, foot [m] and height [m] of each; one tree if `tree` is None."""
    foot = 0.05  # share of a tree's height: the lowest part, whose middle is the tree's place
    numbers = np.zeros(len(points), np.int32) if tree is None else tree
    described: list[dict[str, int | float]] = []
    for number in range(int(numbers.max()) + 1):
        own = points[numbers == number]
        if len(own) == 0:
            continue
        low, height = float(own[:, 2].min()), float(np.ptp(own[:, 2]))
        x, y = np.median(own[own[:, 2] <= low + foot * height, :2], axis=0).tolist()
        place = {"x_m": round(x, 4), "y_m": round(y, 4), "z_m": round(low, 4), "height_m": round(height, 4)}
        described.append({"tree": number + 1, **place})
    return described


def describe_grid(grid: VoxelGrid) -> dict[str, Any]:
    """Summarise a voxel grid: counts and bounds [m]."""
    centres = grid.centres_m.astype(np.float64)
    low, high = centres.min(axis=0), centres.max(axis=0)
    return {
        "num_voxels": len(grid),
        "resolution": grid.resolution,
        "voxel_size_m": grid.voxel_size_m,
        "bounds_m": [low.round(4).tolist(), high.round(4).tolist()],
        "up_axis": "+Z",
    }


def describe_spectrum(spectrum: SparseVoxelSpectrum) -> dict[str, Any]:
    """Summarise a spectrum: grid, frequencies [Hz], loop [s], and how the motion was generated."""
    wind = spectrum.wind
    return describe_grid(spectrum.grid) | {
        "num_frequencies": spectrum.num_frequencies,
        "frequencies_hz": spectrum.frequencies_hz.round(6).tolist(),
        "num_frames": spectrum.num_frames,
        "fps": spectrum.fps,
        "period_s": spectrum.period_s,
        "rest": spectrum.rest,
        "model": spectrum.model,
        "seed": spectrum.seed,
        "wind": None
        if wind is None
        else {"speed_m_s": wind.speed_m_s, "direction_deg": wind.direction_deg, "gust": wind.gust},
        **{f"source_{name}": value for name, value in asdict(spectrum.source).items()},
    }
