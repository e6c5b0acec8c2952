"""The contract of /v1/interact."""

# ruff: noqa: F811

import json
import time
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import AsyncMock

import numpy as np
import pytest
from fastapi.testclient import TestClient
from safetensors.numpy import load

from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.modal.force import Drag, contact_at_voxel
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.system import modal_system
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.storage.assets import delete_asset
from recipes.demo import push_branch
from service.http.request_headers import SAFETENSORS
from service.http.slots import FairSlots
from service.interact.forces import MAX_FORCES
from service.services import Services
from tests.service.conftest import refusal
from tests.service.pushed import client, grown, poke, post, served_id, spectrum, spectrum_id  # noqa: F401


def coordinates(group: dict) -> np.ndarray:
    """Complex [frames, K]."""
    return np.array(group["q"]) @ [1, 1j]


def test_the_answer_is_the_librarys(client: TestClient, spectrum_id: str, spectrum: SparseVoxelSpectrum) -> None:
    force = {"kind": "drag", "at": {"voxel": 40}, "force_n": [0.0, 20.0, 0.0], "start_s": 0.05, "duration_s": 0.2}
    payload = post(
        client, spectrum_id, force, mass_kg=80.0, damping_ratio=0.1, dt_s=0.02, num_frames=30, falloff_m=0.9
    ).json()
    drag = Drag(at=contact_at_voxel(spectrum.grid, 40), force_n=(0.0, 20.0, 0.0), start_s=0.05, duration_s=0.2)
    system = modal_system(spectrum, mass_kg=80.0, damping_ratio=0.1)
    answer = respond(system, group_forces([drag], falloff_m=0.9), dt_s=0.02, num_frames=30)
    q = coordinates(payload["groups"][0])
    assert q.shape == (30, 16)
    assert not q[:, 0].any()
    np.testing.assert_allclose(q[:, 1:], answer.q[:, 0], rtol=1e-9)
    assert payload["groups"][0]["locality"] == {"seed_voxel": 40, "falloff_m": 0.9}
    assert payload["modal_mass_kg_m2"] == pytest.approx(system.modal_mass)
    np.testing.assert_allclose(payload["frequencies_hz"][1:], system.omega / (2 * np.pi))
    assert payload["damping_ratio"] == 0.1


def test_state_in_and_state_out_join_calls(client: TestClient, spectrum_id: str, poke: dict) -> None:
    wind = {"kind": "wind", "wind_m_s": [[3.0, 0.0, 0.0], [6.0, 0.0, 0.0]], "duration_s": 0.25}
    whole = post(client, spectrum_id, poke, wind, num_frames=40).json()
    first = post(client, spectrum_id, poke, wind, num_frames=20).json()
    second = post(
        client, spectrum_id, wind | {"start_s": -20 / 60}, num_frames=20, initial_state=first["final_state"]
    ).json()
    by_place = {json.dumps(group["locality"]): coordinates(group) for group in second["groups"]}
    for group, begun in zip(whole["groups"], first["groups"], strict=True):
        joined = np.concatenate([coordinates(begun), by_place[json.dumps(group["locality"])]])
        np.testing.assert_allclose(joined, coordinates(group), rtol=1e-9, atol=1e-12)


def test_the_demo_holds_a_branch_and_lets_it_go(client, spectrum_id, spectrum, tmp_path: Path) -> None:
    stored, answer = tmp_path / "tree.spectrum.safetensors", tmp_path / "push.json"
    with stored.open("wb") as stream:
        write_spectrum(spectrum, stream)
    push = push_branch(client, {"result": {"spectrum_id": spectrum_id}}, stored, answer)
    height_m = np.ptp(spectrum.grid.coords[:, 2]) * spectrum.grid.voxel_size_m
    assert push["pulled_m"] == pytest.approx(0.05 * height_m, rel=0.01)
    assert 0 < push["left_m"] < push["pulled_m"] / 3
    assert json.loads(answer.read_text())["groups"]


def test_the_same_request_gives_the_same_bytes(client: TestClient, spectrum_id: str, poke: dict) -> None:
    assert post(client, spectrum_id, poke).content == post(client, spectrum_id, poke).content


def test_binary_and_json_say_the_same(client: TestClient, spectrum_id: str, poke: dict) -> None:
    payload = post(client, spectrum_id, poke, accept="application/json").json()
    response = post(client, spectrum_id, poke, accept=SAFETENSORS)
    assert response.headers["Content-Type"] == SAFETENSORS
    arrays = read_binary(response)
    np.testing.assert_allclose(arrays["q"][0] @ [1, 1j], coordinates(payload["groups"][0]), rtol=1e-12)
    final = payload["final_state"]["groups"][0]
    np.testing.assert_allclose(arrays["final_q_dot"][0], final["q_dot"], rtol=1e-12)
    assert arrays["seed_voxel"].tolist() == [final["locality"]["seed_voxel"]]
    assert arrays["falloff_m"].tolist() == [final["locality"]["falloff_m"]]


def read_binary(response) -> dict[str, np.ndarray]:
    assert response.status_code == 200, response.text
    return load(response.content)


def test_vertices_come_in_the_meshs_order(client, spectrum_id, grown, spectrum, poke) -> None:
    options = {"num_frames": 8, "locality": "none"}
    vertices = read_binary(post(client, spectrum_id, poke, accept="*/*", output="vertices", **options))["displacement"]
    voxels = read_binary(post(client, spectrum_id, poke, accept="*/*", output="voxels", **options))["displacement"]
    assert vertices.shape == (8, grown.mesh.num_vertices, 3)
    # a vertex moves about as the voxel does in which it lies
    own = spectrum.grid.rows_of(spectrum.grid.coords_of(grown.mesh.vertices))
    difference = np.linalg.norm(vertices[-1] - voxels[-1][own], axis=1)
    assert np.median(difference) < 0.2 * np.linalg.norm(voxels[-1], axis=1).max()


def test_a_push_at_a_vertex_or_a_voxel_is_a_push_at_its_place(client, spectrum_id, grown, spectrum, poke) -> None:
    vertex, voxel = int(np.argmax(grown.mesh.vertices[:, 2])), poke["at"]["voxel"]
    for at, place in (
        ({"vertex": vertex}, grown.mesh.vertices[vertex]),
        ({"voxel": voxel}, spectrum.grid.centres_m[voxel]),
    ):
        named, placed = (
            post(client, spectrum_id, poke | {"at": where | {"radius_m": 1.0}}).json()["groups"]
            for where in (at, {"point_m": place.tolist()})
        )
        assert named == placed, at


def test_a_pulled_vertex_is_drawn_where_the_answer_says(client: TestClient, spectrum_id: str, grown) -> None:
    """Its bones are not those of the nearest voxel, which alone was pulled before."""
    options = {"start": "held", "num_frames": 1}
    for vertex in np.random.default_rng(0).choice(grown.mesh.num_vertices, 6, replace=False).tolist():
        wanted = [0.05 * grown.mesh.height_m, 0.03 * grown.mesh.height_m, 0.0]
        pull = {"kind": "drag", "at": {"vertex": vertex}, "displacement_m": wanted}
        (reached,) = post(client, spectrum_id, pull, **options).json()["reached"]
        drawn = read_binary(post(client, spectrum_id, pull, accept="*/*", output="vertices", **options))
        np.testing.assert_allclose(drawn["displacement"][0, vertex], reached["reached_m"], atol=1e-4)
        assert reached["why"] or reached["error_m"] <= 0.01 * np.linalg.norm(wanted)


def test_an_unknown_spectrum_is_not_found(client: TestClient, poke: dict) -> None:
    refusal(post(client, "01ARZ3NDEKTSV4RRFFQ69G5FAV", poke), 404, "not-found")


def test_an_unstable_step_is_refused_with_the_longest_stable_one(client, spectrum_id, poke) -> None:
    problem = refusal(post(client, spectrum_id, poke, integrator="explicit-euler"), 422, "unstable-timestep")
    longest = problem["max_dt_s"]
    assert 0 < longest < 1 / 60
    assert post(client, spectrum_id, poke, integrator="explicit-euler", dt_s=longest).status_code == 200


def test_an_unacceptable_or_broken_accept_is_refused(client: TestClient, spectrum_id: str, poke: dict) -> None:
    for accept, output in (("text/html", "modal"), ("application/json;q=0", "modal"), ("application/json", "voxels")):
        refusal(post(client, spectrum_id, poke, accept=accept, output=output), 406, "not-acceptable")
    refusal(post(client, spectrum_id, poke, accept="application/json;q=much"), 400, "bad-request")


@pytest.mark.parametrize(
    ("accept", "given"),
    [
        (None, "application/json"),
        ("*/*", "application/json"),
        ("application/json;q=0.5, application/vnd.safetensors", SAFETENSORS),
        ("application/*;q=0.1, application/vnd.safetensors;q=0.2", SAFETENSORS),
        ("*/*, application/json;q=0", SAFETENSORS),
    ],
)
def test_the_best_accepted_type_is_given(client, spectrum_id, poke, accept, given) -> None:
    assert post(client, spectrum_id, poke, accept=accept).headers["Content-Type"] == given


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"at": {"point_m": [500.0, 0.0, 0.0]}}, "outside of the tree"),
        ({"at": {"voxel": 10**8}}, "does not exist"),
        ({"at": {"vertex": 10**8}}, "does not exist"),
        ({"impulse_n_s": [1e400, 0.0, 0.0]}, "finite"),
        ({"impulse_n_s": [1e9, 0.0, 0.0]}, "1000000"),
        ({"impulse_n_s": None}, "exactly one of impulse_n_s"),
        ({"force_n": [1.0, 0.0, 0.0]}, "exactly one of impulse_n_s"),
        ({"kind": "drag"}, "exactly one of force_n, displacement_m"),
        ({"at": None}, "need at"),
        ({"at": {"voxel": 1, "vertex": 1}}, "exactly one of point_m"),
        ({"kind": "wind", "impulse_n_s": None, "wind_m_s": [1.0, 0.0, 0.0]}, "takes none"),
        ({"kind": "wind", "impulse_n_s": None, "at": None, "wind_m_s": []}, "at least 1 item"),
        ({"sideways": 1}, "/sideways: there is no such field"),
    ],
)
def test_a_force_that_is_none_is_refused(client, spectrum_id, poke, change, words) -> None:
    body = json.dumps({"spectrum_id": spectrum_id, "forces": [poke | change]}).replace("Infinity", "1e400")
    response = client.post("/v1/interact", content=body, headers={"Content-Type": "application/json"})
    of_this_tree = words in ("outside of the tree", "does not exist")
    assert words in refusal(response, 422, "invalid-input" if of_this_tree else "validation-failed")["detail"]


AT_REST = {"locality": None, "q": [[0, 0]] * 16, "q_dot": [[0, 0]] * 16}
PLACES = [AT_REST | {"locality": {"seed_voxel": n, "falloff_m": 1.0}} for n in range(64)]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        *(({"num_frames": 1001}, "1000"), ({"dt_s": 0}, "0"), ({"damping_ratio": -1}, "0"), ({"mass_kg": 0}, "0")),
        ({"initial_state": {"groups": [AT_REST | {"q": [[0, 0]], "q_dot": [[0, 0]]}]}}, "16 bins"),
        ({"initial_state": {"groups": [AT_REST] * 2}}, "same locality"),
        ({"initial_state": {"groups": PLACES}}, "at most 64"),
        ({"warp": False}, "/warp: Input should be True"),
        ({"forces": [{"kind": "wind", "wind_m_s": [1, 0, 0]}] * (MAX_FORCES + 1)}, str(MAX_FORCES)),
    ],
)
def test_a_number_or_a_state_that_is_none_is_refused_with_what_is_allowed(
    client: TestClient, spectrum_id: str, poke: dict, options: dict, words: str
) -> None:
    assert words in refusal(post(client, spectrum_id, poke, **options), 422, "validation-failed")["detail"]


def test_an_answer_that_is_too_large_is_refused_with_what_fits(client, spectrum_id, poke, monkeypatch) -> None:
    monkeypatch.setattr("service.routes.interact.MAX_DISPLACEMENT_BYTES", 1_000_000)
    for output in ("voxels", "vertices"):
        response = post(client, spectrum_id, poke, accept="*/*", output=output, num_frames=600)
        assert "frames at a time" in refusal(response, 422, "validation-failed")["detail"]


def test_gaussians_of_a_mesh_are_refused(client: TestClient, spectrum_id: str, poke: dict) -> None:
    problem = refusal(post(client, spectrum_id, poke, accept="*/*", output="gaussians"), 422, "invalid-input")
    assert "needs a cloud" in problem["detail"]


def test_vertices_are_gone_with_their_asset_and_voxels_are_not(
    client: TestClient,
    services: Services,
    grown,
    spectrum: SparseVoxelSpectrum,
    poke: dict,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asset_id = "01ARZ3NDEKTSV4RRFFQ69G5FAW"
    own_id = served_id(client, grown.mesh, spectrum, tmp_path, asset_id)
    few = {"accept": "*/*", "num_frames": 2}
    assert post(client, own_id, poke, output="vertices", **few).status_code == 200
    delete_asset(services.store, asset_id)
    refusal(post(client, own_id, poke, output="vertices", **few), 410, "expired")
    assert post(client, own_id, poke, output="voxels", **few).status_code == 200
    now = services.store.clock()
    monkeypatch.setattr(services.store, "clock", lambda: now + 10_000)
    refusal(post(client, own_id, poke), 410, "expired")


def test_large_answers_are_made_a_few_at_a_time(client, services, spectrum_id, poke, monkeypatch) -> None:
    monkeypatch.setattr("service.routes.interact.SLOT_WAIT_S", 0.1)
    large = {"accept": "*/*", "output": "voxels", "num_frames": 3}
    for slots, status in ((0, 503), (1, 200)):
        monkeypatch.setattr(services.large_answers, "slot", FairSlots(slots, per_owner=1).slot)
        answers = [post(client, spectrum_id, poke, **large) for _ in range(3)]  # each gives its slot back
        assert [answer.status_code for answer in answers] == [status] * 3
        assert all(("Retry-After" in answer.headers) == (status == 503) for answer in answers)
        assert post(client, spectrum_id, poke, num_frames=3).status_code == 200  # modal ones are small


def test_the_work_of_an_answer_is_bounded(client, spectrum_id, spectrum, poke, monkeypatch) -> None:
    forces = [poke | {"at": {"voxel": voxel}} for voxel in (0, 1, 2)]
    monkeypatch.setattr("service.routes.interact.MAX_WORK", 3 * 10 * len(spectrum.grid))
    assert post(client, spectrum_id, *forces, output="voxels", num_frames=10).status_code == 200
    refused = refusal(post(client, spectrum_id, *forces, output="voxels", num_frames=11), 422, "validation-failed")
    assert "ask for 10 frames" in refused["detail"]
    assert post(client, spectrum_id, *forces, num_frames=11).status_code == 200


def test_an_answer_stops_once_its_client_has_left(client, spectrum_id, poke, monkeypatch) -> None:
    frames = []

    def slowly(*_: object, **__: object) -> Iterator[np.ndarray]:
        for number in range(600):
            time.sleep(0.01)
            frames.append(number)
            yield np.zeros((1, 3), np.float32)

    monkeypatch.setattr(InteractiveTree, "voxels", slowly)
    body = json.dumps({"spectrum_id": spectrum_id, "forces": [poke], "num_frames": 600, "output": "voxels"}).encode()
    headers = [(b"host", b"localhost"), (b"content-type", b"application/json")]
    scope = {"type": "http", "method": "POST", "path": "/v1/interact", "raw_path": b"/v1/interact", "headers": headers}
    scope |= {"query_string": b"", "scheme": "http", "http_version": "1.1", "client": ("127.0.0.1", 1), "state": {}}
    messages = [{"type": "http.request", "body": body}, {"type": "http.disconnect"}]
    client.portal.call(client.app, scope, AsyncMock(side_effect=messages), AsyncMock())
    assert 0 < len(frames) < 100
