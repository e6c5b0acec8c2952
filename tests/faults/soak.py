"""An hour of everyday traffic, and what every process weighs meanwhile.

`python -m tests.faults.soak --minutes 60`: `dynamictree serve` as a user starts it, with a short retention so that a
steady state is reached. Prints a line a minute and a summary; exits with 1 if a process grew or an answer was wrong.
"""

import argparse
import random
import statistics
import sys
import time
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import httpx
import numpy as np
import psutil

from tests.faults.conftest import Service, start, stop
from tests.faults.drill import parse, tell
from tests.faults.shapes import bumpy_sphere

SAMPLE_S = 15.0
WARM_SHARE = 0.25
"""The first quarter is left out: models, caches and pools fill."""

GROWTH_SHARE, GROWTH_MIB = 0.08, 16.0
"""What the line through a process's quietest samples may rise in an hour, whichever is more."""

QUIET_SAMPLES = 12
"""The least of so many samples, three minutes, counts: what a job needs while it runs is no growth."""

SETTINGS = {
    "DYNAMICTREE_LEASE_S": "60",
    "DYNAMICTREE_HEARTBEAT_S": "10",
    "DYNAMICTREE_WORKER_THREADS": "1",
    "DYNAMICTREE_SPECTRUM_CACHE_BYTES": str(8 * 2**20),  # full within the warm-up
    "DYNAMICTREE_ARTIFACT_RETENTION_S": "300",
    "DYNAMICTREE_ASSET_RETENTION_S": "300",
    "DYNAMICTREE_JOB_RETENTION_S": "300",
    "DYNAMICTREE_RETENTION_INTERVAL_S": "20",
    "DYNAMICTREE_WORKER_TASKS_PER_CHILD": "1000",  # no fresh process hides a leak
}
ENDED = {"succeeded", "failed", "canceled"}
PARAMS = {"num_steps": 3, "formats": ["motion", "ply"]}


ROLES = {"valkey": "redis", "uvicorn": "api", "worker.parse": "parser"}
ROLES |= {f"worker.{name}": name for name in ("heartbeat", "housekeeper")}


def role(process: psutil.Process) -> str:
    """What a process of the service does, by its command."""
    words = " ".join(process.cmdline())
    for sign, name in ROLES.items():
        if sign in words:
            return name
    if "celery" in words:
        parent = process.parent()
        return "pool" if parent is not None and "celery" in " ".join(parent.cmdline()) else "worker"
    return "serve" if "dynamictree.cli" in words else "other"


def anonymous_bytes(pid: int) -> int:
    """Memory of a process that no file backs, swapped parts included.

    A process's private pages (USS) jump by the size of torch's libraries, about 120 MiB, when another process maps the
    same files or no longer does.

    Raises:
        psutil.NoSuchProcess: it has ended.
    """
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    except (FileNotFoundError, ProcessLookupError) as error:
        raise psutil.NoSuchProcess(pid) from error
    kib = {line.split(":")[0]: int(line.split()[1]) for line in lines}
    return 1024 * (kib["Anonymous"] + kib["Swap"])


@dataclass(kw_only=True)
class Scales:
    """Anonymous memory of every role over time."""

    at_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    mib: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    files: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))

    def weigh(self, root: int, now_s: float) -> None:
        main = psutil.Process(root)
        for process in [main, *main.children(recursive=True)]:
            with suppress(psutil.NoSuchProcess, psutil.AccessDenied):
                name = role(process)
                if name in ("parser", "other"):
                    continue
                self.at_s[name].append(now_s)
                self.mib[name].append(anonymous_bytes(process.pid) / 2**20)
                self.files[name].append(process.num_fds())

    def slopes(self, until_s: float) -> dict[str, dict[str, float]]:
        """Line through the least of every QUIET_SAMPLES of each role after the warm-up."""
        report = {}
        for name, weights in self.mib.items():
            at, mib = np.array(self.at_s[name]), np.array(weights)
            late = at > until_s * WARM_SHARE
            if late.sum() < 3:
                continue
            starts = np.arange(0, late.sum(), QUIET_SAMPLES)
            quiet = np.minimum.reduceat(mib[late], starts)
            slope = np.polyfit(at[late][starts] / 3600, quiet, 1)[0] if len(quiet) > 1 else 0.0
            report[name] = {
                "mib": round(float(np.median(mib[late])), 1),
                "mib_quiet_first": round(float(quiet[0]), 1),
                "mib_quiet_last": round(float(quiet[-1]), 1),
                "slope_mib_per_h": round(float(slope), 2),
                "files": max(self.files[name]),
                "samples": int(late.sum()),
            }
        return report


@dataclass(kw_only=True)
class Traffic:
    """One user after the other."""

    service: Service
    rng: random.Random
    answers: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    poll_ms: list[float] = field(default_factory=list)

    def visit(self) -> None:
        """Upload, ask, poll, fetch, push; sometimes wrongly, sometimes with a change of mind."""
        mesh = bumpy_sphere(20 + self.rng.randrange(10), seed=self.rng.randrange(1 << 30), width=0.2)
        asset = self.ask("POST", "/v1/assets", {201}, files={"file": ("tree.obj", mesh)}).json()
        body = {"type": "animate", "asset_id": asset["id"], "seed": self.rng.randrange(99), "params": PARAMS}
        url = self.ask("POST", "/v1/jobs", {202}, json=body).headers["Location"]
        if self.rng.random() < 0.1:
            self.ask("POST", url + "/cancel", {202, 409})
        job = self.finish(url)
        self.states[str(job["state"])] += 1
        for artifact in self.ask("GET", url + "/artifacts", {200}).json()["artifacts"]:
            content = self.ask("GET", artifact["url"], {200}).content
            if sha256(content).hexdigest() != artifact["sha256"]:
                self.wrong.append(f"{artifact['name']} differs from its hash")
        if job["state"] == "succeeded":
            spectrum_id = str(job["result"]["spectrum_id"])  # type: ignore[index]
            self.push(spectrum_id)
            if self.rng.random() < 0.2:  # also in the warm-up: threads that a burst starts are no growth
                with ThreadPoolExecutor(16) as threads:
                    list(threads.map(lambda _: self.push(spectrum_id, num_frames=600), range(16)))
        self.ask("GET", "/v1/jobs?limit=50", {200})
        self.ask("GET", "/v1/jobs/01AAAAAAAAAAAAAAAAAAAAAAAA", {404})
        self.ask("POST", "/v1/jobs", {422}, json={"type": "nothing"})
        self.ask("POST", "/v1/assets", {415, 422}, files={"file": ("tree.obj", self.rng.randbytes(2000))})

    def push(self, spectrum_id: str, num_frames: int = 60) -> None:
        force = {"kind": "impulse", "at": {"point_m": [0, 0, 1.5], "radius_m": 1}, "impulse_n_s": [1, 0, 0]}
        body = {"spectrum_id": spectrum_id, "forces": [force], "dt_s": 1 / 60, "num_frames": num_frames}
        self.ask("POST", "/v1/interact", {200}, json=body)

    def finish(self, url: str) -> dict[str, object]:
        while True:
            began = time.monotonic()
            job: dict[str, object] = self.ask("GET", url, {200}).json()
            self.poll_ms.append(1000 * (time.monotonic() - began))
            if job["state"] in ENDED:
                return job
            time.sleep(0.3)

    def ask(self, method: str, path: str, expected: set[int], **content: object) -> httpx.Response:
        response = self.service.client.request(method, path, **content)  # type: ignore[arg-type]
        self.answers[str(response.status_code)] += 1
        if response.status_code not in expected:
            self.wrong.append(f"{method} {path}: {response.status_code} {response.text[:300]}")
        return response


def run(folder: Path, *, minutes: float, seed: int, pause_s: float) -> dict[str, object]:
    """Let it run so long, and tell what was seen."""
    service = start(folder / "state", **SETTINGS)
    scales, traffic = Scales(), Traffic(service=service, rng=random.Random(seed))
    began = weighed = reported = time.monotonic()
    visits = 0
    try:
        while (now := time.monotonic()) - began < minutes * 60:
            traffic.visit()
            visits += 1
            if now - weighed >= SAMPLE_S:
                weighed = now
                scales.weigh(service.process.pid, now - began)
            if now - reported >= 60:
                reported = now
                latest = {name: round(mib[-1], 1) for name, mib in scales.mib.items()}
                tell({"minute": round((now - began) / 60, 1), "visits": visits, "mib": latest})
            time.sleep(pause_s)
        state_mib = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20
    finally:
        code = stop(service, 600)  # it yields to whatever else runs here
    slopes = scales.slopes(minutes * 60)
    grown = [
        name for name, seen in slopes.items() if seen["slope_mib_per_h"] > max(GROWTH_MIB, GROWTH_SHARE * seen["mib"])
    ]
    return {
        "minutes": minutes,
        "seed": seed,
        "visits": visits,
        "states": dict(traffic.states),
        "answers": dict(traffic.answers),
        "poll_p50_ms": round(statistics.median(traffic.poll_ms), 1),
        "poll_p99_ms": round(float(np.percentile(traffic.poll_ms, 99)), 1),
        "state_folder_mib": round(state_mib, 1),
        "memory": slopes,
        "grown": grown,
        "wrong": traffic.wrong[:20],
        "num_wrong": len(traffic.wrong),
        "exit": code,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pause", type=float, default=5, help="seconds between two users")
    given, folder = parse(parser, prefix="soak-")
    report = run(folder, minutes=given.minutes, seed=given.seed, pause_s=given.pause)
    tell(report)
    if report["grown"] or report["num_wrong"] or report["exit"]:
        sys.exit(f"grown: {report['grown']}, wrong answers: {report['num_wrong']}, exit {report['exit']}; see {folder}")


if __name__ == "__main__":
    main()
