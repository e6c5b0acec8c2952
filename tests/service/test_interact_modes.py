"""Modes for clients: the references of `recipes` give what the server gives."""

# ruff: noqa: F811

import json
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from safetensors.numpy import load

from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum
from recipes.modes_reference import Modes
from tests.js_tools import in_node
from tests.service.conftest import refusal
from tests.service.pushed import client, grown, poke, post, spectrum, spectrum_id  # noqa: F401

REFERENCE = Path(__file__).parents[2] / "recipes" / "modes_reference.mjs"
DRIVER = """
import { readFileSync } from "node:fs";
import { Modes } from "REFERENCE";
const [modesPath, requestPath] = process.argv.slice(1);
const file = readFileSync(modesPath);
const modes = new Modes(file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength));
const { q, weights, places, bends } = JSON.parse(readFileSync(requestPath, "utf8"));
const reaches = places.map((at) => at && modes.reach(at.seed_voxel, at.falloff_m));
const still = new Float64Array(3 * modes.joint_parent.length);
const { rotation, place } = modes.poses(modes.theta(q, reaches), bends ? Float64Array.from(bends) : still);
const payload = { voxels: modes.voxels(q, weights), rotation, place };
console.log(JSON.stringify(payload, (_, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value)));
"""


@pytest.fixture(scope="module")
def modes(client: TestClient, spectrum_id: str) -> bytes:
    response = client.get(f"/v1/spectra/{spectrum_id}/modes")
    assert (response.status_code, response.headers["Content-Type"]) == (200, "application/vnd.safetensors")
    return response.content


def evaluated(client: TestClient, spectrum_id: str, *forces: object, **options: object):
    """Last frame's coordinates [G, K, 2], weights [G, V] and localities, as a client gets them."""
    payload = post(client, spectrum_id, *forces, **options).json()
    q = np.array([group["q"][-1] for group in payload["groups"]])
    places = [group["locality"] for group in payload["groups"]]
    return q, [reach(client, spectrum_id, place) for place in places], places


def turned(reference: Modes, q: np.ndarray, places: list[dict | None]) -> np.ndarray:
    return reference.theta(q, [place and reference.reach(**place) for place in places])


def carried(reference: Modes, theta: np.ndarray, bends: np.ndarray, grown, spectrum: SparseVoxelSpectrum) -> np.ndarray:
    """Displacement of the voxels, each the mean of the bones that carry it."""
    rotation, place = reference.poses(theta, bends)
    weights, points = rig_of(grown.mesh, spectrum).voxels, spectrum.grid.centres_m
    arm = points[:, None] - reference.foot[weights.rows]
    there = np.einsum("vwij,vwj->vwi", rotation[weights.rows], arm) + place[weights.rows]
    return np.einsum("vw,vwi->vi", weights.shares, there) - points


def reach(client: TestClient, spectrum_id: str, locality: dict | None) -> np.ndarray | None:
    if locality is None:
        return None
    response = client.get(f"/v1/spectra/{spectrum_id}/reach", params=locality)
    assert response.status_code == 200, response.text
    return np.frombuffer(response.content, np.uint8) / 255


def weights_of(rows: list, num_voxels: int) -> np.ndarray:
    return np.stack([np.ones(num_voxels) if row is None else row for row in rows])


def pushes(poke: dict, spectrum: SparseVoxelSpectrum) -> list[dict]:
    """Two places and wind: two local groups, one that moves the whole tree."""
    side = int(np.argmax(np.abs(spectrum.grid.coords[:, 0] - 16)))
    return [
        poke | {"impulse_n_s": [40.0, 10.0, 0.0]},
        poke | {"at": {"voxel": side}, "impulse_n_s": [0.0, 30.0, 0.0]},
        {"kind": "wind", "wind_m_s": [12.0, 0.0, 0.0]},
    ]


@pytest.mark.parametrize("locality", ["none", "geodesic"])
def test_the_python_reference_gives_the_servers_voxels(client, spectrum_id, grown, spectrum, poke, modes, locality):
    options, forces = {"num_frames": 12, "locality": locality, "falloff_m": 2.0}, pushes(poke, spectrum)
    response = post(client, spectrum_id, *forces, accept="*/*", output="voxels", **options)
    expected = load(response.content)["displacement"][-1]
    q, _, places = evaluated(client, spectrum_id, *forces, **options)
    reference = Modes(modes)
    moved = carried(reference, turned(reference, q, places), reference.bends(0, np.zeros((0, 3))), grown, spectrum)
    np.testing.assert_allclose(moved, expected, atol=1e-2 * np.abs(expected).max())
    assert len(q) == (1 if locality == "none" else 3)


def of_javascript(
    modes: bytes, q: np.ndarray, weights: np.ndarray, places: list, folder: Path, bends: np.ndarray | None = None
) -> dict:
    """What the JavaScript reference gives."""
    (folder / "modes").write_bytes(modes)
    request = {"q": q.reshape(len(q), -1).tolist(), "weights": weights.tolist(), "places": places}
    if bends is not None:
        request["bends"] = bends.ravel().tolist()
    (folder / "request.json").write_text(json.dumps(request))
    return in_node(DRIVER.replace("REFERENCE", REFERENCE.as_uri()), folder / "modes", folder / "request.json")


def test_the_javascript_reference_is_the_python_one(client, spectrum_id, spectrum, poke, modes, tmp_path) -> None:
    q, rows, places = evaluated(client, spectrum_id, *pushes(poke, spectrum), num_frames=12, falloff_m=2.0)
    weights = weights_of(rows, len(spectrum.grid))
    payload = of_javascript(modes, q, weights, places, tmp_path)
    reference = Modes(modes)
    rotation, place = reference.poses(turned(reference, q, places), reference.bends(0, np.zeros((0, 3))))
    np.testing.assert_allclose(np.reshape(payload["voxels"], (-1, 3)), reference.voxels(q, weights), atol=1e-6)
    np.testing.assert_allclose(np.reshape(payload["rotation"], (-1, 3, 3)), rotation, atol=1e-6)
    np.testing.assert_allclose(np.reshape(payload["place"], (-1, 3)), place, atol=1e-5)


def test_shapes_are_twice_the_coefficients_to_a_part_in_thirty_thousand(spectrum, modes) -> None:
    reference = Modes(modes)
    shapes = reference.shapes @ [1, 1j]
    expected = 2 * spectrum.coefficients
    expected[:, 0] = 0
    worst = np.abs(shapes - expected).max(axis=(0, 2))
    assert (worst <= reference.file["scale_m"] * 0.75 + 1e-12).all()
    assert np.array_equal(reference.file["coords"], spectrum.grid.coords)
    np.testing.assert_allclose(reference.file["frequencies_hz"], spectrum.frequencies_hz, rtol=1e-6)
    summed, q = ((1 + 1j) * expected).real.sum(axis=1), np.ones((1, spectrum.num_frequencies, 2))
    np.testing.assert_allclose(reference.voxels(q, np.ones((1, len(summed)))), summed, atol=4e-3 * np.abs(summed).max())


@pytest.mark.parametrize(
    ("query", "code"),
    [("seed_voxel=99999999&falloff_m=1", "invalid-input"), ("seed_voxel=0&falloff_m=nan", "validation-failed")],
)
def test_a_reach_that_is_none_is_refused(client: TestClient, spectrum_id: str, query: str, code: str) -> None:
    refusal(client.get(f"/v1/spectra/{spectrum_id}/reach?{query}"), 422, code)


@pytest.fixture
def drag(poke: dict) -> dict:
    """A pull at the top, across it."""
    return {"kind": "drag", "at": poke["at"], "displacement_m": [0.3, 0.1, 0.0]}


def test_the_references_bend_joints_as_the_server_does(
    client: TestClient, spectrum_id: str, grown, spectrum: SparseVoxelSpectrum, drag: dict, modes: bytes, tmp_path: Path
) -> None:
    options = {"num_frames": 2, "falloff_m": 2.0, "start": "held"}
    file = load(post(client, spectrum_id, drag, accept="*/*", output="voxels", **options).content)
    expected = file["displacement"][-1]
    answer = post(client, spectrum_id, drag, **options).json()
    (group,) = answer["groups"]
    weights = reach(client, spectrum_id, group["locality"])[None]
    np.testing.assert_allclose(file["bend_0"], group["bend"], atol=1e-12)
    reference = Modes(modes)
    bends = reference.bends(drag["at"]["voxel"], np.array(group["bend"][-1]))
    assert np.abs(bends).max() > 0.01
    q = np.array([group["q"][-1]])
    theta = turned(reference, q, [group["locality"]])
    moved = carried(reference, theta, bends, grown, spectrum)
    np.testing.assert_allclose(moved, expected, atol=1e-2 * np.abs(expected).max())
    (reached,) = answer["reached"]
    np.testing.assert_allclose(expected[drag["at"]["voxel"]], reached["reached_m"], atol=1e-4)
    assert reached["error_m"] < 0.05 * np.linalg.norm(reached["wanted_m"])
    assert reached["why"] is None
    rotation, place = reference.poses(theta, bends)
    payload = of_javascript(modes, q, weights, [group["locality"]], tmp_path, bends)
    np.testing.assert_allclose(np.reshape(payload["rotation"], (-1, 3, 3)), rotation, atol=1e-5)
    np.testing.assert_allclose(np.reshape(payload["place"], (-1, 3)), place, atol=1e-5)


def test_a_bend_goes_on_in_the_next_call_and_a_wrong_one_is_refused(client, spectrum_id, drag) -> None:
    options = {"falloff_m": 2.0}
    whole = post(client, spectrum_id, drag, num_frames=8, **options).json()
    first = post(client, spectrum_id, drag, num_frames=4, **options).json()
    later = drag | {"start_s": -4 / 60}
    rest = post(client, spectrum_id, later, num_frames=4, initial_state=first["final_state"], **options).json()
    bends = first["groups"][0]["bend"] + rest["groups"][0]["bend"]
    np.testing.assert_allclose(bends, whole["groups"][0]["bend"], atol=1e-9)
    for name in ("bend", "bend_rate"):
        first["final_state"]["groups"][0][name].append([0.0, 0.0, 0.0])
    refused = post(client, spectrum_id, later, num_frames=4, initial_state=first["final_state"], **options)
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid-input")


def test_a_pull_that_would_stretch_the_tree_says_how_far_it_goes(client, spectrum_id, poke) -> None:
    up = {"kind": "drag", "at": poke["at"], "displacement_m": [0.0, 0.0, 2.0]}
    (reached,) = post(client, spectrum_id, up, num_frames=1, start="held").json()["reached"]
    assert reached["error_m"] > 1.0
    assert "do not stretch" in reached["why"]
