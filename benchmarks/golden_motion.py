"""Motion of fixed trees for comparison before and after a code change: a hash and sizes of each spectrum."""

import os
from hashlib import sha256
from pathlib import Path

import numpy as np

from benchmarks._machine import machine
from dynamictree import method
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.requests import Wind
from lab.dataset.sample import make_sample

SPECIES = ("round-broadleaf", "weeping", "palm", "pine", "shrub", "conical-conifer")
SEEDS = (7, 2, 3, 4, 5, 6, 11, 12, 13, 14, 15, 16)
SAMPLES = Path(os.environ.get("DYNAMICTREE_SAMPLES", "../shared/data"))
MESHES = (
    "mesh/tree-lime.glb",
    "mesh/quaternius_common_tree/CommonTree_2.obj",
    "../foreign/mesh/pcu_tree.ply",
    "../foreign/mesh/maple_pack_obj/tree.obj",
    "../cases/bevy_forest_tree.glb",
    "../cases/potted.glb",
)
WIND = Wind(speed_m_s=8.0)
SHORTEST_EDGE_M = 1e-6


def run() -> dict[str, object]:
    """Measure twelve generated trees and the available sample meshes."""
    rows = {}
    for number, seed in enumerate(SEEDS):
        species = SPECIES[number % len(SPECIES)]
        rows[f"{species} {seed}"] = _figures(make_sample(seed, species).mesh)
    for path in (SAMPLES / name for name in MESHES):
        if path.exists():
            with path.open("rb") as stream:
                rows[path.name] = _figures(read_mesh(stream, file_type=path.suffix[1:]))
    return {"trees": rows, **machine("numpy", "torch")}


def _figures(mesh: TriangleMesh) -> dict[str, object]:
    voxels = method.voxelize(mesh)
    spectrum = method.generate(voxels, seed=0, wind=WIND)
    frames = np.stack(list(method.animate(mesh, wind=WIND, num_frames=10, flutter=0.0)))  # [T, N, 3]
    edges = edges_of(mesh.faces)
    length = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    edges, length = edges[length > SHORTEST_EDGE_M], length[length > SHORTEST_EDGE_M]
    stretch = np.abs(np.linalg.norm(frames[:, edges[:, 0]] - frames[:, edges[:, 1]], axis=2) / length - 1)
    return {
        "voxels": len(spectrum.coefficients),
        "frequencies": spectrum.coefficients.shape[1],
        "voxels_sha256": sha256(np.ascontiguousarray(voxels.grid.coords)).hexdigest()[:12],
        "spectrum_sha256": sha256(np.ascontiguousarray(spectrum.coefficients)).hexdigest()[:12],
        "spectrum_rms_m": float(f"{np.sqrt((np.abs(spectrum.coefficients) ** 2).sum(axis=1).mean()):.6g}"),
        "frames_rms_m": float(f"{np.sqrt(((frames - mesh.vertices) ** 2).sum(axis=2).mean()):.6g}"),
        "stretch_p99": float(f"{np.quantile(stretch, 0.99):.4g}"),
    }
