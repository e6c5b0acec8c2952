"""How far leaf cards leave their twigs: growth of the gap between each loose part and the nearest larger one.

A part's point nearest to a part of at least twice its extent (both surfaces cut at 1/256 of the mesh's extent) is
followed with its counterpart over one loop of the default wind. Parts farther than 5 % of the height from any such at
rest are counted as `floating` and followed with the nearest larger part. The measure does not use
`devoxelize/attachment.py`, which chooses what hangs where. Generated trees, and the meshes of DYNAMICTREE_SAMPLES; or
the files that are named.

    python -m benchmarks part_gaps
    python -m benchmarks.part_gaps tree.glb other.obj
"""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64
from scipy.spatial import cKDTree

from benchmarks._machine import machine
from dynamictree.commands.source import load_mesh
from dynamictree.export.vertex_motion import vertex_motion
from dynamictree.mesh import TriangleMesh, connected_parts, part_bounds, weld
from dynamictree.method import generate, voxelize
from dynamictree.requests import Wind
from dynamictree.spectrum import to_motion
from dynamictree.voxel.grid import grid_frame
from dynamictree.voxel.voxelize import surface_pieces
from lab.dataset.sample import make_sample

TREES = ((3, "round-broadleaf"), (4, "maple"), (5, "conical-conifer"), (6, "weeping"))
MESHES = ("mesh/tree-lime.glb", "mesh/quaternius_common_tree/CommonTree_2.obj")
CLEARLY_LARGER = 2.0
FARTHEST = 0.05  # of the height
FINENESS = 256
TARGET_P99, TARGET_MAX = 0.003, 0.01


def run() -> dict[str, object]:
    rows = {name: gap_growth(mesh) for name, mesh in _trees()}
    return {
        "value": max(row["p99"] for row in rows.values()),
        "unit": "of the height",
        "target": TARGET_P99,
        "target_max": TARGET_MAX,
        "trees": rows,
        **machine("numpy", "scipy"),
    }


def _trees() -> Iterator[tuple[str, TriangleMesh]]:
    for seed, species in TREES:
        yield f"{species} {seed}", make_sample(seed, species).mesh
    samples = os.environ.get("DYNAMICTREE_SAMPLES")
    for name in MESHES if samples else ():
        yield name, load_mesh(Path(str(samples)) / name)


def gap_growth(mesh: TriangleMesh) -> dict[str, float]:
    """Growth of the gaps of a mesh's parts, largest over the loop, relative to the height."""
    spectrum = generate(voxelize(mesh), wind=Wind())
    motion_of_mesh, _ = vertex_motion(mesh, spectrum, on_progress=lambda share: None)
    moving, vertex = weld(mesh.moving_part)
    first = np.unique(vertex, return_index=True)[1]
    corners, weights, floating = nearest_larger(moving)
    motion = to_motion(np.ascontiguousarray(motion_of_mesh.coefficients[first]), spectrum.num_frames)  # [T, n, 3]
    height = float(np.ptp(moving.vertices[np.unique(moving.faces), 2]))
    rest = _apart(moving.vertices, corners, weights)
    growth = np.max([_apart(moving.vertices + frame, corners, weights) - rest for frame in motion], axis=0) / height
    near, far = growth[~floating], growth[floating]
    return {
        "parts": len(growth),
        "floating": int(floating.sum()),
        "p99": round(float(np.percentile(near, 99)), 5) if len(near) else 0.0,
        "max": round(float(near.max()), 5) if len(near) else 0.0,
        "floating_max": round(float(far.max()), 5) if len(far) else 0.0,
    }


def nearest_larger(
    mesh: TriangleMesh,
) -> tuple[Int64[np.ndarray, "B 2 3"], Float32[np.ndarray, "B 2 3"], Bool[np.ndarray, " B"]]:
    """Of each part but the largest, the corners and weights of its nearest point and of that on a larger part."""
    origin_m, size_m = grid_frame(mesh.vertices[np.unique(mesh.faces)], FINENESS)
    pieces = surface_pieces(mesh, origin_m, size_m, FINENESS)
    part = connected_parts(mesh.faces, mesh.num_vertices)
    low, high = part_bounds(part, mesh.vertices)
    extent = (high - low).max(axis=1)
    owner = part[mesh.faces[pieces.faces, 0]]
    places = np.einsum("pi,pic->pc", pieces.centroids, mesh.vertices[mesh.faces[pieces.faces]])
    reach = FARTHEST * float(np.ptp(places[:, 2]))
    owned, order = np.unique(owner), np.argsort(owner, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(owner)[owned])[:-1])
    chosen, floating = [], []
    trees: dict[int, tuple[cKDTree, Int64[np.ndarray, " _"]]] = {}
    for number, own in sorted(zip(owned, groups, strict=True), key=lambda one: -extent[one[0]]):
        for clearly in (CLEARLY_LARGER, 1.0):
            least = clearly * extent[number]
            step = int(np.ceil(4 * np.log2(least)))  # one search tree per quarter of an octave
            if step not in trees:
                above = np.flatnonzero(extent[owner] >= 2 ** (step / 4))
                trees[step] = cKDTree(places[above]), above
            tree, above = trees[step]
            if len(above) == 0:
                continue
            nearest = tree.query(places[own])
            gap, other = np.asarray(nearest[0]), np.asarray(nearest[1])
            if number in owner[above[other]]:
                continue
            best = int(np.argmin(gap))
            if clearly == 1.0 or gap[best] <= reach:
                chosen.append((own[best], above[other[best]]))
                floating.append(clearly == 1.0)
                break
    pairs = np.array(chosen, np.int64).reshape(-1, 2)
    return mesh.faces[pieces.faces[pairs]].astype(np.int64), pieces.centroids[pairs], np.array(floating, bool)


def _apart(
    points: Float32[np.ndarray, "n 3"], corners: Int64[np.ndarray, "B 2 3"], weights: Float32[np.ndarray, "B 2 3"]
) -> Float64[np.ndarray, " B"]:
    places = np.einsum("bsi,bsic->bsc", weights, points[corners], dtype=np.float64)
    distance: Float64[np.ndarray, " B"] = np.linalg.norm(places[:, 0] - places[:, 1], axis=1)
    return distance


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(json.dumps({"file": name, **gap_growth(load_mesh(Path(name)))}), flush=True)
