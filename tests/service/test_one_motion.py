"""One place for one vertex at one time: the method, files that others read, `/interact` and the page's own module."""

# ruff: noqa: F811

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from safetensors.numpy import load

from benchmarks._read_exports import read_product
from benchmarks._trees import KINDS, tree_of_kind
from dynamictree import method
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import ExportParams
from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from jobs.store import new_id
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.js_tools import in_node
from tests.service.pushed import client, post, served_id  # noqa: F401

WEB = Path(__file__).parents[2] / "web"
TIMES = 10
DRIVER = """
import { readFileSync } from "node:fs";
import { gustyAir } from "WEB/motion/flutter.js";
import { windCoordinates } from "WEB/motion/modes.js";
import { readTensors } from "WEB/motion/tensors.js";
import { displaced, swingBones } from "WEB/motion/swing.js";
const file = readFileSync(process.argv[1]);
const { tensors, metadata } = readTensors(file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength));
const { vertices, times } = JSON.parse(readFileSync(process.argv[2], "utf8"));
const K = tensors.turn_shapes.length / tensors.turn_parent.length / 6;
const swings = new Float32Array(8 * tensors.turn_parent.length);
const at = (phase) => {
  const air = gustyAir(JSON.parse(metadata.wind), phase);
  swingBones(tensors, { q: windCoordinates(K, phase), turn: 0, air }, swings);
  return vertices.map((v) => displaced(tensors, v, swings));
};
console.log(JSON.stringify(Array.from({ length: times }, (_, i) => at(i / times))));
"""
FORMATS = ("motion", "glb", "glb-morph", "usd", "usd-skinned", "alembic", "vat", "ply")


def test_a_vertex_has_one_place(client, tmp_path: Path) -> None:
    grown = make_sample(3, "sapling", wind=Wind(speed_m_s=5.5, direction_deg=40.0))
    spectrum = replace(voxel_spectrum(grown, 32)[1], fps=12.0, num_frames=5 * TIMES)  # the same loop, with few frames
    assert require_one_place(client, grown.mesh, spectrum, tmp_path) > 1e-3 * grown.mesh.height_m, "leaves flutter"


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("speed_m_s", [5.0, 12.0, 20.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_vertex_has_one_place_in_every_kind_of_tree(kind, speed_m_s, client, tmp_path) -> None:
    mesh = tree_of_kind(kind)
    if mesh is None:
        pytest.skip(f"{kind} is missing: set DYNAMICTREE_SAMPLES")
    motion = method.generate(method.voxelize(mesh), wind=Wind(speed_m_s=speed_m_s), num_steps=2, seed=0)
    require_one_place(client, mesh, motion, tmp_path)


def require_one_place(client, mesh: TriangleMesh, spectrum: SparseVoxelSpectrum, folder: Path) -> float:
    """Within 0.01 % of the height at a thousand vertices and ten times; return how far leaves flutter [m]."""
    vertices = np.random.default_rng(0).choice(mesh.num_vertices, min(1000, mesh.num_vertices), replace=False)
    expected, calm = (
        np.stack(list(method.move(spectrum, mesh, num_frames=TIMES, flutter=size)))[:, vertices] for size in (1.0, 0.0)
    )
    assert np.linalg.norm(expected, axis=2).max() > 0.005 * mesh.height_m
    spectrum_id, rig = served_id(client, mesh, spectrum, folder, new_id()), rig_of(mesh, spectrum)
    swaying = replace(rig, turns=rig.turns * (np.arange(rig.turns.shape[1]) > 0)[:, None].astype(np.float32))
    for phase, theta in zip((0.1, 0.6), swaying.theta(np.array([0.1, 0.6])), strict=True):
        gap = pushed(client, spectrum_id, phase, rig.turns.shape[1]) - rig.displacement(
            theta, mesh.vertices, rig.vertices
        )
        assert np.linalg.norm(gap, axis=1).max() < 1e-4 * mesh.height_m
    places = {"page": on_the_page(client, spectrum_id, vertices, folder)}
    stride = spectrum.num_frames // TIMES
    for compression, formats in (("none", FORMATS), ("meshopt", ("glb", "glb-morph"))):
        (folder / compression).mkdir()
        params = ExportParams(formats=formats, fps=spectrum.fps, glb_compression=compression)  # type: ignore[arg-type]
        for name, path in write_products(mesh, spectrum, params, folder / compression).items():
            frames = read_product(name, path, mesh.vertices)[: spectrum.num_frames : stride]
            places[f"{name} {compression}"] = frames[:, vertices]
    height_m = mesh.height_m
    most = dict.fromkeys(("motion none", "usd none", "alembic none", "ply none"), 3e-6 * height_m)
    most |= {"vat none": 0.9 * float(np.spacing(np.float16(np.abs(expected).max())))}  # half a step on each axis
    most |= {"glb-morph meshopt": 1e-3 * height_m}  # 2K - 1 targets in steps of 0.12 mm
    for name, moved in places.items():
        apart = np.linalg.norm(moved - (calm if "morph" in name else expected), axis=2).max()
        assert apart < most.get(name, 1e-4 * height_m), f"{name}: {apart:.2g} m"
    return float(np.linalg.norm(expected - calm, axis=2).max())


def pushed(client: TestClient, spectrum_id: str, phase: float, num_modes: int) -> np.ndarray:
    """Displacements [N, 3] of `/interact` in the coordinates of the loop, about the pose at rest: it has no lean."""
    q = np.exp(2j * np.pi * phase * np.arange(num_modes))
    q[0] = 0
    group = {"locality": None, "q": np.stack([q.real, q.imag], axis=1).tolist(), "q_dot": [[0, 0]] * num_modes}
    state = {"initial_state": {"groups": [group]}, "num_frames": 1, "dt_s": 1e-6}
    answer = post(client, spectrum_id, accept="application/vnd.safetensors", output="vertices", **state)
    assert answer.status_code == 200, answer.text
    return load(answer.content)["displacement"][0]


def on_the_page(client: TestClient, spectrum_id: str, vertices: np.ndarray, folder: Path) -> np.ndarray:
    """Displacements [T, n, 3] of the page's module in node."""
    (folder / "surface").write_bytes(client.get(f"/v1/spectra/{spectrum_id}/surface").content)
    (folder / "request.json").write_text(json.dumps({"vertices": vertices.tolist(), "times": TIMES}))
    return np.array(in_node(DRIVER.replace("WEB", WEB.as_uri()), folder / "surface", folder / "request.json"))
