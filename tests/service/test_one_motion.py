"""One place for one vertex at one time: the method, products that others read, and the page's own module."""

# ruff: noqa: F811

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from benchmarks._played import played_morphs, played_skin, played_usdz
from dynamictree import method
from dynamictree.export.write import write_products
from dynamictree.formats.tensors.motion import read_motion
from dynamictree.requests import ExportParams
from dynamictree.spectrum import SparseVoxelSpectrum
from tests.service.pushed import grown, spectrum, spectrum_id  # noqa: F401

WEB = Path(__file__).parents[2] / "web"
TIMES = 10
DRIVER = """
import { readFileSync } from "node:fs";
import { windCoordinates } from "WEB/motion/modes.js";
import { readTensors } from "WEB/motion/tensors.js";
import { displaced, swingBones } from "WEB/motion/swing.js";
const file = readFileSync(process.argv[2]);
const { tensors } = readTensors(file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength));
const { vertices, times } = JSON.parse(readFileSync(process.argv[3], "utf8"));
const K = tensors.turn_scale_rad.length;
const swings = new Float32Array(8 * tensors.turn_parent.length);
const at = (phase) => {
  swingBones(tensors, windCoordinates(K, phase), 0, swings);
  return vertices.map((v) => displaced(tensors, v, swings));
};
console.log(JSON.stringify(Array.from({ length: times }, (_, i) => at(i / times))));
"""


def test_a_vertex_has_one_place(
    client: TestClient, spectrum_id: str, grown, spectrum: SparseVoxelSpectrum, tmp_path: Path
) -> None:
    """Within 0.01 % of the height, at a thousand vertices and ten times of the loop."""
    vertices = np.random.default_rng(0).choice(grown.mesh.num_vertices, 1000, replace=False)
    expected = np.stack(list(method.move(spectrum, grown.mesh, num_frames=TIMES)))[:, vertices]
    stride = spectrum.num_frames // TIMES
    formats = ("glb", "glb-morph", "motion", "usd")
    files = write_products(grown.mesh, spectrum, ExportParams(formats=formats), tmp_path)
    with files["motion"].open("rb") as stream:
        stored = read_motion(stream).displacement
    opened = {
        "motion": stored,
        "glb": played_skin(files["glb"].read_bytes()),
        "glb-morph": played_morphs(files["glb-morph"].read_bytes()),
        "usd": played_usdz(files["usd"]),
    }
    places = {name: frames[: spectrum.num_frames : stride][:, vertices] for name, frames in opened.items()}
    surface = client.get(f"/v1/spectra/{spectrum_id}/surface").content
    places["page"] = on_the_page(surface, vertices, tmp_path)
    assert np.linalg.norm(expected, axis=2).max() > 0.01 * grown.mesh.height_m
    for name, moved in places.items():
        apart = np.linalg.norm(moved - expected, axis=2).max()
        assert apart < 1e-4 * grown.mesh.height_m, f"{name}: {apart:.2g} m"


def on_the_page(surface: bytes, vertices: np.ndarray, folder: Path) -> np.ndarray:
    """Displacements [T, n, 3] of the page's module in node."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed: the page's module needs it")
    (folder / "surface").write_bytes(surface)
    (folder / "request.json").write_text(json.dumps({"vertices": vertices.tolist(), "times": TIMES}))
    (folder / "driver.mjs").write_text(DRIVER.replace("WEB", WEB.as_uri()))
    command = [node, str(folder / "driver.mjs"), str(folder / "surface"), str(folder / "request.json")]
    return np.array(json.loads(subprocess.run(command, check=True, capture_output=True, timeout=60).stdout))
