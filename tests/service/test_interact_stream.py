"""The stream: a drag that goes on."""

# ruff: noqa: F811

import asyncio
import time
from functools import partial
from unittest.mock import AsyncMock

import numpy as np
import pytest
from fastapi.testclient import TestClient
from starlette.websockets import WebSocket, WebSocketDisconnect

from dynamictree.modal.force import Drag, Impulse, contact_at_voxel
from dynamictree.modal.interactive_tree import Answer, ForceGroup, InteractiveTree, Locality
from dynamictree.modal.response import group_forces, respond
from dynamictree.modal.step import exact_step
from dynamictree.modal.system import modal_system
from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.clients.keys import create_key, revoke_key
from jobs.database.tables import assets, jobs
from service.app import create_app
from service.http import slots
from service.interact import session as interact_session
from service.interact.forces import ForcePayload
from service.routes import interact_stream
from service.services import Services
from tests.service.pushed import client, grown, poke, spectrum, spectrum_id  # noqa: F401

URL = "/v1/interact/stream"


def opened(socket, spectrum_id: str, **options: object) -> dict:
    socket.send_json({"type": "open", "spectrum_id": spectrum_id, **options})
    reply = socket.receive_json()
    assert reply["type"] == "opened", reply
    return reply


def frames(socket, count: int) -> list[dict]:
    """Frames as a client takes them that keeps up."""
    taken = []
    while len(taken) < count:
        reply = socket.receive_json()
        assert reply["type"] == "frame", reply
        socket.send_json({"type": "ack", "frame": reply["frame"]})
        taken.append(reply)
    return taken


def pull(vector: list[float], voxel: int = 40) -> dict:
    return {"type": "force", "force": {"kind": "drag", "at": {"voxel": voxel}, "force_n": vector}}


def coordinates(frame: dict) -> np.ndarray:
    return np.array(frame["groups"][0]["q"]) @ [1, 1j]


@pytest.mark.parametrize(
    ("kind", "vector", "Force", "falloff_m"),
    [("drag", "force_n", Drag, 1.0), ("impulse", "impulse_n_s", Impulse, None)],
)
def test_frames_are_those_of_the_library(client, spectrum_id, spectrum, kind, vector, Force, falloff_m) -> None:
    where = {"locality": "none"} if falloff_m is None else {"falloff_m": falloff_m}
    with client.websocket_connect(URL) as socket:
        reply = opened(socket, spectrum_id, rate_hz=50, mass_kg=80.0, damping_ratio=0.1, **where)
        force = {"kind": kind, "at": {"voxel": 40}, vector: [0.0, 20.0, 0.0]}
        socket.send_json({"type": "force", "force": force})
        taken = frames(socket, 12)
    system = modal_system(spectrum, mass_kg=80.0, damping_ratio=0.1)
    assert reply["modal_mass_kg_m2"] == pytest.approx(system.modal_mass)
    groups = group_forces(
        [Force(at=contact_at_voxel(spectrum.grid, 40), **{vector: (0.0, 20.0, 0.0)})], falloff_m=falloff_m
    )
    expected = respond(system, groups, dt_s=1 / 50, num_frames=2000).q[:, 0]
    place = None if falloff_m is None else {"seed_voxel": 40, "falloff_m": falloff_m}
    for frame in taken:
        np.testing.assert_allclose(coordinates(frame)[1:], expected[frame["frame"]], rtol=1e-9)
        assert frame["groups"][0]["locality"] == place
    assert [frame["frame"] for frame in taken] == sorted({frame["frame"] for frame in taken})


def test_a_frame_after_the_close_of_another_task_is_no_error() -> None:
    async def close_then_send() -> None:
        messages = [{"type": "websocket.connect"}]
        socket = WebSocket({"type": "websocket"}, AsyncMock(side_effect=messages), AsyncMock())
        await socket.accept()
        await socket.close()
        with pytest.raises(WebSocketDisconnect):
            await interact_stream._send(socket, {"type": "frame"})

    asyncio.run(close_then_send())


def test_a_new_pointer_replaces_the_old_and_release_lets_it_settle(client, spectrum_id, monkeypatch) -> None:
    monkeypatch.setattr(interact_session, "SETTLED_M", 0.02)
    with client.websocket_connect(URL) as socket:
        opened(socket, spectrum_id, damping_ratio=1.0)
        socket.send_json(pull([5.0, 0.0, 0.0]))
        socket.send_json(pull([0.0, 5.0, 0.0]))
        frames(socket, 5)
        socket.send_json({"type": "release"})
        for _ in range(2000):
            reply = socket.receive_json()
            if reply["type"] == "rest":
                break
            socket.send_json({"type": "ack", "frame": reply["frame"]})
        assert reply["type"] == "rest"
        # it goes on where it was asked to
        socket.send_json({"type": "force", "force": {"kind": "wind", "wind_m_s": [8.0, 0.0, 0.0]}})
        assert frames(socket, 1)[0]["frame"] > reply["frame"]


def test_who_does_not_acknowledge_gets_few_frames_and_then_the_newest(client: TestClient, spectrum_id: str) -> None:
    with client.websocket_connect(URL) as socket:
        opened(socket, spectrum_id, rate_hz=120)
        socket.send_json(pull([5.0, 0.0, 0.0]))
        unread = [socket.receive_json() for _ in range(interact_session.WINDOW)]
        assert [frame["frame"] for frame in unread] == list(range(1, interact_session.WINDOW + 1))
        socket.send_json({"type": "release", "kind": "wind"})  # nothing: it only takes a while
        socket.send_json({"type": "nonsense"})
        assert socket.receive_json()["type"] == "problem"  # no frame came before it
        time.sleep(1.0)  # 120 frames, of which a busy machine may miss most
        socket.send_json({"type": "ack", "frame": interact_session.WINDOW})
        newest = socket.receive_json()
        assert newest["frame"] > interact_session.WINDOW + 1
        assert newest["skipped"] == newest["frame"] - interact_session.WINDOW - 1


def test_a_grip_follows_its_pointer_in_the_bent_shape_and_is_let_go_smoothly(grown, spectrum) -> None:
    rig = rig_of(grown.mesh, spectrum)
    tree = InteractiveTree(modal_system(spectrum, damping_ratio=0.1), rig, grown.mesh)
    system, dt_s = tree.system, 1 / 60
    row = int(np.argmax(spectrum.grid.coords[:, 2]))
    session = interact_session.Session(system=system, step=exact_step(system, dt_s))
    grips = interact_session.Grips(lambda: tree, system)
    force_of = partial(
        interact_session.force_of,
        system=system,
        dt_s=dt_s,
        falloff_m=2.0,
        vertex_contact=lambda vertex, radius_m: None,
        grips=grips,
    )

    def place() -> np.ndarray:
        """Where the grip is in the shape that a client draws."""
        group = ForceGroup(locality=session.localities[0])
        bends = (session.bends[0].turn[None],)
        answer = Answer(
            groups=(group,), q=session.state.q[None], final=session.state, bends=bends, final_bends=tuple(session.bends)
        )
        return next(tree.voxels(answer))[row].astype(np.float64)

    def pull(target: np.ndarray) -> None:
        payload = {"kind": "drag", "at": {"voxel": row}, "displacement_m": target.tolist()}
        session.push(force_of(ForcePayload.model_validate(payload)))

    target, path = np.zeros(3), []
    for frame in range(30):
        target = np.array([0.4, 0.2, 0.0]) * min(frame / 15, 1)
        pull(target)
        session.tick()
        path.append(place())
    assert np.linalg.norm(path[-1] - target) < 0.05 * np.linalg.norm(target)
    assert session.next_frame()["reached"]["why"] is None
    session.release("drag")
    for _ in range(240):
        session.tick()
        path.append(place() if session.localities else np.zeros(3))
    jumps = np.linalg.norm(np.diff(path[29:], n=2, axis=0), axis=1) / dt_s**2
    omega = system.omega.max()
    assert jumps.max() < 1.5 * omega**2 * np.linalg.norm(target)
    assert np.abs(path[-30:]).max() < 0.5 * np.linalg.norm(target), "it rings down"


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ({"type": "force", "force": {"kind": "drag"}}, "validation-failed"),
        ({"type": "sing"}, "validation-failed"),
        (pull([1.0, 0.0, 0.0], voxel=10**8), "invalid-input"),
        (
            {"type": "force", "force": {"kind": "wind", "wind_m_s": [1.0, 0.0, 0.0], "duration_s": 1.0}},
            "validation-failed",
        ),
    ],
)
def test_a_bad_message_is_reported_and_the_stream_goes_on(client, spectrum_id, message, code) -> None:
    with client.websocket_connect(URL) as socket:
        opened(socket, spectrum_id)
        socket.send_json(message)
        reply = socket.receive_json()
        assert (reply["type"], reply["code"]) == ("problem", code)
        assert reply["detail"]
        socket.send_json(pull([1.0, 0.0, 0.0]))
        assert frames(socket, 1)


def test_places_that_swing_are_bounded(client: TestClient, spectrum_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interact_session, "MAX_GROUPS", 2)
    with client.websocket_connect(URL) as socket:
        opened(socket, spectrum_id, damping_ratio=0.0, rate_hz=1)
        for voxel in (40, 41, 42):
            force = {"kind": "impulse", "at": {"voxel": voxel}, "impulse_n_s": [50.0, 0.0, 0.0]}
            socket.send_json({"type": "force", "force": force})
        replies = (socket.receive_json() for _ in range(10))  # how many frames come before depends on the machine
        assert next(reply for reply in replies if reply["type"] == "problem")["code"] == "validation-failed"


@pytest.mark.parametrize(
    ("first", "code"),
    [
        ({"type": "open", "spectrum_id": "01ARZ3NDEKTSV4RRFFQ69G5FAV"}, "not-found"),
        ({"type": "open", "spectrum_id": "x", "rate_hz": 1e9}, "validation-failed"),
        ({"type": "ack", "frame": 1}, "validation-failed"),
    ],
)
def test_a_bad_first_message_is_reported_and_ends_it(client: TestClient, first: dict, code: str) -> None:
    with client.websocket_connect(URL) as socket:
        socket.send_json(first)
        assert socket.receive_json()["code"] == code
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_json()
        assert closed.value.code == interact_stream.INVALID


def test_silence_shouting_and_bytes_end_it(client, spectrum_id, monkeypatch) -> None:
    monkeypatch.setattr(interact_stream, "OPEN_S", 0.05)
    monkeypatch.setattr(interact_stream, "IDLE_S", 0.05)
    for code, say in (
        (interact_stream.INVALID, lambda socket: None),
        (interact_stream.DONE, lambda socket: opened(socket, spectrum_id)),
        (interact_stream.TOO_LARGE, lambda socket: socket.send_text("a" * (interact_stream.MAX_MESSAGE + 1))),
        (1003, lambda socket: socket.send_bytes(b"{}")),
    ):
        with client.websocket_connect(URL) as socket:
            say(socket)
            with pytest.raises(WebSocketDisconnect) as closed:
                socket.receive_json()
            assert closed.value.code == code


def test_a_page_sends_its_key_as_a_protocol(services: Services, spectrum_id: str) -> None:
    _, key = create_key(services.store, name="page")
    locked = create_app(services.settings.model_copy(update={"keys": "required"}))
    with TestClient(locked, "http://localhost") as client:
        offered = [interact_stream.PROTOCOL, f"bearer.{key}"]
        with client.websocket_connect(URL, subprotocols=offered) as socket:
            assert socket.accepted_subprotocol == interact_stream.PROTOCOL
            socket.send_json({"type": "open", "spectrum_id": spectrum_id})
            assert socket.receive_json()["code"] == "not-found"  # it is in, but this tree is another owner's
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(URL, subprotocols=[interact_stream.PROTOCOL]):
            raise AssertionError("the stream was opened without a key")


def test_a_key_that_is_revoked_ends_its_streams(services, spectrum_id, monkeypatch) -> None:
    monkeypatch.setattr(slots, "CHECK_S", 0.05)
    app = create_app(services.settings.model_copy(update={"keys": "required"}))
    with TestClient(app, "http://localhost") as client:
        store = app.state.services.store
        record, key = create_key(store, name="page")
        with store.writing() as connection:
            for table in (jobs, assets):
                connection.execute(table.update().values(owner=record.owner))
        with client.websocket_connect(URL, headers={"Authorization": f"Bearer {key}"}) as socket:
            opened(socket, spectrum_id)
            revoke_key(store, record.id)
            with pytest.raises(WebSocketDisconnect) as closed:
                socket.receive_json()
            assert closed.value.code == interact_stream.INVALID


def test_a_step_of_many_places_costs_little_more_than_one(spectrum: SparseVoxelSpectrum) -> None:
    system = modal_system(spectrum)

    def step_s(count: int) -> float:
        session = interact_session.Session(system=system, step=exact_step(system, 1 / 120))
        for voxel in range(count):
            kick = np.ones(system.num_modes, np.complex128)
            at = Locality(seed_voxel=voxel, falloff_m=1.0)
            session.push(interact_session.ModalForce(kind="impulse", locality=at, acceleration=kick))
        began = time.process_time()
        for _ in range(300):
            session.tick()
        assert len(session.localities) == count
        return time.process_time() - began

    step_s(1)
    assert step_s(64) < 8 * step_s(1)  # a loop over places takes 40 times as long
