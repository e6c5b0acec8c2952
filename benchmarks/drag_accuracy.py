"""Accuracy of pulled vertices over HTTP: 500 random places on ten trees, pulled by a tenth of the height.

Each pull is a client's request (`start=held`) to a separate API, once for `vertices` and once for the
coordinates alone, which is timed. Measured: the distance of the drawn vertex from its target and from `reached_m`, as
shares of the pull; the motion of parts that neither carry the place nor hang on it, and their own bending; and the
growth of edges.

    DYNAMICTREE_SAMPLES=../shared/data python -m benchmarks drag_accuracy
"""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
from safetensors.numpy import load

from benchmarks._api_process import start_api, store_spectrum
from benchmarks._machine import BRIEF, machine
from dynamictree import method
from dynamictree.commands.input_files import read_source
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.requests import Reading
from dynamictree.rig.rig import Rig, rig_of
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.settings import Settings
from lab.dataset.sample import make_sample, voxel_spectrum
from recipes.demo import SEED, SPECIES
from service.services import open_services

GENERATED = ((3, "sapling"), (4, "maple"), (5, "conical-conifer"), (6, "weeping"), (12, "palm"))
FILES = (
    "mesh/tree-lime.glb",
    "mesh/quaternius_common_tree/CommonTree_2.obj",
    "../cases/bevy_forest_tree.glb",
    "splat/tree_10k.splat",
)
PULLS_PER_TREE = 3 if BRIEF else 50
PULL_SHARE = 0.1  # [share of the height]
TARGET = 0.01  # [share of the pull]
SHORTEST_M = 1e-4  # length of the shortest edge that counts
TOO_FAR = "do not stretch"


def run() -> dict[str, object]:
    rng, trees = np.random.default_rng(0), {}
    with tempfile.TemporaryDirectory() as folder:
        sources = list(_trees())
        with open_services(Settings(state_dir=Path(folder))) as services:
            ids = [store_spectrum(services, spectrum, mesh) for _, mesh, spectrum in sources]
        with start_api(Path(folder)) as (url, _), httpx.Client(base_url=url, timeout=300) as client:
            for (name, mesh, spectrum), spectrum_id in zip(sources, ids, strict=True):
                trees[name] = _pull_errors(client, spectrum_id, mesh, spectrum, rng)
    rows = {name: np.concatenate([tree[name] for tree in trees.values()]) for name in next(iter(trees.values()))}
    return {
        "value": _spread(rows["error"][rows["long_enough"]])["p95"],
        "unit": "of the pull: error of the drawn vertex where the branch is long enough, 95th percentile",
        "target": TARGET,
        **_figures(rows),
        "trees": {name: _figures(tree) for name, tree in trees.items()},
        **machine("numpy", "scipy", "numba", "torch"),
    }


def _trees() -> Iterator[tuple[str, TriangleMesh, SparseVoxelSpectrum]]:
    for seed, species in GENERATED[:1] if BRIEF else GENERATED:
        sample = make_sample(seed, species)
        yield species, sample.mesh, voxel_spectrum(sample)[1]
    if BRIEF:
        return
    demo = make_sample(SEED, SPECIES).mesh
    yield "demo", demo, method.generate(method.voxelize(demo), seed=0)
    for path in (Path(os.environ.get("DYNAMICTREE_SAMPLES", "../shared/data")) / name for name in FILES):
        if path.exists():
            mesh, capture = read_source(path, Reading())
            yield path.name, mesh, method.generate(method.voxelize(mesh), seed=0, of_cloud=capture is not None)


def _pull_errors(
    client: httpx.Client,
    spectrum_id: str,
    mesh: TriangleMesh,
    spectrum: SparseVoxelSpectrum,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    rig, edges = rig_of(mesh, spectrum), edges_of(mesh.faces)
    length = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    edges, length = edges[length > SHORTEST_M], length[length > SHORTEST_M]
    bone = rig.vertices.rows[np.arange(mesh.num_vertices), rig.vertices.shares.argmax(axis=1)]
    above_ground = mesh.vertices[:, 2] > mesh.vertices[:, 2].min() + 0.05 * mesh.height_m
    pull_m = PULL_SHARE * mesh.height_m
    rows: dict[str, list[float]] = {}
    for vertex in rng.choice(np.flatnonzero((bone > 0) & above_ground), PULLS_PER_TREE, replace=False):
        direction = rng.normal(size=3)
        wanted = pull_m * direction / np.linalg.norm(direction)
        drag = {"kind": "drag", "at": {"vertex": int(vertex)}, "displacement_m": wanted.tolist()}
        body = {"spectrum_id": spectrum_id, "forces": [drag], "num_frames": 1, "start": "held"}
        answer = client.post("/v1/interact", json=body | {"output": "vertices"})
        moved = load(answer.raise_for_status().content)["displacement"][0].astype(np.float64)
        began = time.perf_counter()
        (reached,) = client.post("/v1/interact", json=body).raise_for_status().json()["reached"]
        latency_ms = 1e3 * (time.perf_counter() - began)
        outside = ~_on_path(rig, int(bone[vertex]))[bone] & (bone > 0)
        now = mesh.vertices + moved
        growth = np.abs(np.linalg.norm(now[edges[:, 0]] - now[edges[:, 1]], axis=1) / length - 1)
        row = {
            "error": np.linalg.norm(moved[vertex] - wanted) / pull_m,
            "reached_m_off": np.linalg.norm(moved[vertex] - reached["reached_m"]) / pull_m,
            "long_enough": TOO_FAR not in (reached["why"] or ""),
            "says_why": reached["why"] is not None,
            "outside": _percentile(np.linalg.norm(moved[outside], axis=1)) / pull_m,
            "outside_own": _own_bending(rig, bone, outside, mesh.vertices, moved) / pull_m,
            "stretch": float(np.percentile(growth, 99)),
            "latency_ms": latency_ms,
        }
        for name, value in row.items():
            rows.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in rows.items()}


def _on_path(rig: Rig, bone: int) -> np.ndarray:
    """Return whether each bone carries `bone` or hangs on it."""
    parent, line = rig.skeleton.parent, np.zeros(len(rig.skeleton), bool)
    line[bone] = True
    for below in range(bone + 1, len(parent)):
        line[below] = line[parent[below]]
    while bone >= 0:
        line[bone] = True
        bone = int(parent[bone])
    return line


def _own_bending(rig: Rig, bone: np.ndarray, outside: np.ndarray, rest: np.ndarray, moved: np.ndarray) -> float:
    """Return the 95th percentile of outside branches' motion at vertices, minus each branch's rigid motion [m]."""
    parent = rig.skeleton.parent
    lies_outside = np.zeros(len(parent), bool)
    lies_outside[bone[outside]] = True
    branch = np.arange(len(parent))
    for below in range(1, len(parent)):
        if lies_outside[below] and lies_outside[parent[below]]:
            branch[below] = branch[parent[below]]
    left = np.zeros(len(rest))
    rows = np.flatnonzero(outside)
    rows = rows[np.argsort(branch[bone[rows]], kind="stable")]
    for own in np.split(rows, np.flatnonzero(np.diff(branch[bone[rows]])) + 1):
        at, to = rest[own] - rest[own].mean(axis=0), (rest + moved)[own] - (rest + moved)[own].mean(axis=0)
        u, _, v = np.linalg.svd(at.T @ to)
        u[:, 2] *= np.sign(np.linalg.det(u @ v))
        left[own] = np.linalg.norm(at @ (u @ v) - to, axis=1)
    return _percentile(left[outside])


def _percentile(values: np.ndarray) -> float:
    """Return the 95th percentile; 0 if everything carries the place or hangs on it."""
    return float(np.percentile(values, 95)) if len(values) else 0.0


def _figures(rows: dict[str, np.ndarray]) -> dict[str, object]:
    long_enough = rows["long_enough"]
    return {
        "places": len(long_enough),
        "long_enough": int(long_enough.sum()),
        "without_a_word": int(((rows["error"] > TARGET) & ~rows["says_why"]).sum()),
        "error_where_long_enough": _spread(rows["error"][long_enough]),
        **{name: _spread(rows[name]) for name in rows if rows[name].dtype != bool},
    }


def _spread(values: np.ndarray) -> dict[str, float]:
    if len(values) == 0:
        return {}
    percentiles = {f"p{p}": float(f"{np.percentile(values, p):.3g}") for p in (50, 95)}
    return {"mean": float(f"{values.mean():.3g}"), **percentiles, "worst": float(f"{values.max():.3g}")}
