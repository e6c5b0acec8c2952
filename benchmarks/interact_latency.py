"""Latency of /v1/interact over HTTP: p50 and p99 for 60 frames of coordinates, at 100 requests/s and with 1, 10 and 100
clients; time per frame of a mesh's 100,000 vertices in binary [ms].

The load is generated on the same two cores. At 100 requests/s, a request is timed from its due time, so waiting counts.
The server's CPU time per request does not depend on other load.
"""

import asyncio
import tempfile
import time
from pathlib import Path

import httpx
import numpy as np

from benchmarks._api_process import processor_s, serve_tree
from benchmarks._interaction import scene
from benchmarks._machine import BRIEF, machine

TARGET_P50_MS, TARGET_P99_MS = 5.0, 20.0
RATE_HZ, RATE_S = 100.0, 0.05 if BRIEF else 4.0
REQUESTS = {1: 1} if BRIEF else {1: 100, 10: 200, 100: 300}
FRAMES = 1 if BRIEF else 60
BINARY = "application/vnd.safetensors"


def run() -> dict[str, object]:
    prepared = scene()
    top = int(np.argmax(prepared.spectrum.grid.coords[:, 2]))
    with (
        tempfile.TemporaryDirectory() as state,
        serve_tree(Path(state), prepared.spectrum, prepared.mesh) as (url, spectrum_id, server),
    ):
        push = {"kind": "impulse", "at": {"voxel": top}, "impulse_n_s": [5.0, 1.0, 0.0]}
        body = {"spectrum_id": spectrum_id, "forces": [push], "num_frames": 60}
        figures = asyncio.run(_measure(url + "/v1/interact", body, server))
        vertices = asyncio.run(_vertices(url + "/v1/interact", body | {"output": "vertices", "num_frames": FRAMES}))
    steady = figures["at 100 requests/s, json"]
    return {
        "value": steady["p50_ms"],
        "unit": "ms",
        "target": TARGET_P50_MS,
        "p99": steady["p99_ms"],
        "target_p99": TARGET_P99_MS,
        "rows": figures,
        "vertices": vertices | {"count": prepared.mesh.num_vertices, "frames": FRAMES},
        "sizes": {"frames": 60, "modes": 15, "voxels": len(prepared.spectrum.grid)},
        **machine("numpy", "scipy", "numba"),
    }


async def _measure(url: str, body: dict[str, object], server: int) -> dict[str, dict[str, float]]:
    limits = httpx.Limits(max_connections=128, max_keepalive_connections=128)
    figures = {}
    async with httpx.AsyncClient(limits=limits, timeout=60) as client:
        for name, accept in (("json", "application/json"), ("binary", BINARY)):
            headers = {"Accept": accept}

            async def push(headers: dict[str, str] = headers) -> None:
                response = await client.post(url, json=body, headers=headers)
                assert response.status_code == 200, response.text

            for _ in range(20):
                await push()
            spent, num_frames = processor_s(server), int(RATE_HZ * RATE_S)
            figures[f"at 100 requests/s, {name}"] = await _constant_rate(push)
            cpu_ms = (processor_s(server) - spent) / num_frames * 1e3
            figures[f"at 100 requests/s, {name}"]["server_cpu_ms_a_request"] = round(cpu_ms, 2)
            for clients, requests in REQUESTS.items():
                figures[f"{clients} clients, {name}"] = await _closed_loop(push, clients, requests)
    return figures


async def _vertices(url: str, body: dict[str, object]) -> dict[str, float]:
    """Time vertices: the first response, which prepares the tree's mesh, and the median of five more."""
    waits = []
    async with httpx.AsyncClient(timeout=600) as client:
        for _ in range(6):
            begin = time.perf_counter()
            response = await client.post(url, json=body, headers={"Accept": BINARY})
            assert response.status_code == 200, response.text
            waits.append(time.perf_counter() - begin)
    return {"first_s": round(waits[0], 2), "ms_a_frame": round(float(np.median(waits[1:])) / FRAMES * 1e3, 2)}


async def _constant_rate(push) -> dict[str, float]:
    """Send a request every 10 ms, without waiting for earlier responses."""
    waits: list[float] = []
    begin = time.perf_counter()

    async def one(due: float) -> None:
        await push()
        waits.append(time.perf_counter() - due)

    running = []
    for number in range(int(RATE_HZ * RATE_S)):
        due = begin + number / RATE_HZ
        await asyncio.sleep(max(0.0, due - time.perf_counter()))
        running.append(asyncio.create_task(one(due)))
    await asyncio.gather(*running)
    return _figures(waits, time.perf_counter() - begin)


async def _closed_loop(push, clients: int, requests: int) -> dict[str, float]:
    """Run concurrent clients that each send a request as soon as the previous one is answered."""
    waits: list[float] = []
    begin = time.perf_counter()

    async def one() -> None:
        for _ in range(requests // clients):
            sent = time.perf_counter()
            await push()
            waits.append(time.perf_counter() - sent)

    await asyncio.gather(*(one() for _ in range(clients)))
    return _figures(waits, time.perf_counter() - begin)


def _figures(waits: list[float], seconds: float) -> dict[str, float]:
    p50, p99 = np.percentile(waits, [50, 99]) * 1e3
    return {
        "p50_ms": round(float(p50), 2),
        "p99_ms": round(float(p99), 2),
        "requests_s": round(len(waits) / seconds, 1),
    }
