"""Steps of `make compose`: each is timed, and ends the drill where it fails."""

import hashlib
import json
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from tests.compose.engine import run_program

ROOT = Path(__file__).parents[2]
TREE = ROOT / "web" / "examples" / "round-broadleaf.glb"
OURS = ("api", "worker", "housekeeper")
STARTED = (*OURS, "redis", "postgres", "objects")
UP_S = 900
JOB_S = 1200
FORMATS = ["glb", "png"]
CELERY_SIGNAL_LINES = ("worker: Warm shutdown (MainProcess)", "worker: Cold shutdown (MainProcess)", "Restoring ")
"""What Celery's signal handlers write past all logging."""

ERASE_LINE = "\x1b[2K"
"""What `docker compose logs` puts ahead of a line, even where the output is no terminal."""


@dataclass(kw_only=True)
class Drill:
    """One project at one engine."""

    compose: tuple[str, ...]
    environment: Mapping[str, str]
    client: httpx.Client
    steps: list[dict[str, object]] = field(default_factory=list)
    artifacts: dict[str, str] = field(default_factory=dict)  # address: sha256

    def run_all(self, *, build: bool, image_bytes: Callable[[], int]) -> None:
        """From the build to the second start."""
        with self.step("build") as notes:
            if build:
                self.docker("build", timeout_s=3600)
            notes.append(f"image {image_bytes() / 1e9:.2f} GB")
        with self.step("up, all healthy") as notes:
            self._up()
            notes.append(self._states())
        with self.step("a key, and nothing without one"):
            assert self.client.get("/v1/presets").status_code == 401
            key = self.docker("exec", "-T", "api", "dynamictree", "keys", "create", "drill").split()[0]
            self.client.headers["Authorization"] = f"Bearer {key}"
            assert self.client.get("/v1/presets").status_code == 200
        with self.step("a first job, its artifacts by their hashes") as notes:
            asset = self._upload()
            notes.append(self._finished(self._animate(asset, seed=1)))
        with self.step("the API restarts"):
            self.docker("restart", "api")
            self._until(self._ready, "the API is ready", UP_S)
            self._check_artifacts()
        with self.step("kill -9 of the worker in diffuse, attempt 2 succeeds") as notes:
            job = self._in_diffuse(asset, seed=2)
            began = time.monotonic()
            self.docker("exec", "-T", "worker", "sh", "-c", "kill -9 -1", check=False)
            notes.append(self._finished(job, attempt=2) + f", {time.monotonic() - began:.0f} s after the kill")
        with self.step("the worker is stopped in diffuse and hands back, goes on after a start") as notes:
            job = self._in_diffuse(asset, seed=3)
            began = time.monotonic()
            self.docker("stop", "worker", timeout_s=120)
            handed_back = self._job(job)
            notes.append(f"handed back {time.monotonic() - began:.0f} s after the stop")
            assert (handed_back["state"], handed_back["attempt"]) == ("running", 2), handed_back
            self.docker("start", "worker")
            notes.append(self._finished(job, attempt=2))
        with self.step("every line of ours is JSON"):
            self._check_logs()
        with self.step("down"):
            memory_notes = self._memory()
            self.docker("down", "--timeout", "60", timeout_s=300)
        with self.step("up again, data is there") as notes:
            self._up()
            self._check_artifacts()
            notes += [f"{len(self.artifacts)} artifacts by their hashes", memory_notes]

    @contextmanager
    def step(self, name: str) -> Iterator[list[str]]:
        """Time a step; what is put into the list is printed beside it."""
        began, notes = time.monotonic(), list[str]()
        try:
            yield notes
        except BaseException:
            self.tell(f"FAILED: {name}", began, "; ".join(notes))
            raise
        self.tell(name, began, "; ".join(notes))

    def tell(self, name: str, began: float, detail: str) -> None:
        """Print one line."""
        line = {"step": name, "seconds": round(time.monotonic() - began, 1), "detail": detail}
        self.steps.append(line)
        print(json.dumps(line), flush=True)  # noqa: T201

    def docker(self, *command: str, timeout_s: float = 600, check: bool = True) -> str:
        """Run `docker compose …` and return what it prints."""
        whole = (*self.compose, *command)
        return run_program(whole, self.environment, timeout_s=timeout_s, check=check, folder=ROOT).stdout

    def write_logs(self, path: Path) -> None:
        """Keep what the containers said."""
        path.write_text(self.docker("logs", "--no-color", check=False))

    def _up(self) -> None:
        self.docker("up", "--detach", "--wait", "--wait-timeout", str(UP_S), timeout_s=UP_S + 60)
        self._until(self._ready, "the service is ready", 120)

    def _states(self) -> str:
        states = {}
        for line in self.docker("ps", "--format", "json").splitlines():
            payload = json.loads(line)
            states[payload["Service"]] = payload["Health"]
        assert states == dict.fromkeys(STARTED, "healthy"), states
        return ", ".join(sorted(states))

    def _memory(self) -> str:
        ids = self.docker("ps", "--quiet").split()
        stats = [self.compose[0], "stats", "--no-stream", "--format", "{{.Name}} {{.MemUsage}}", *ids]
        done = subprocess.run(stats, env=self.environment, capture_output=True, text=True, timeout=60, check=True)
        return ", ".join(line.split("-drill-")[-1].partition(" / ")[0] for line in sorted(done.stdout.splitlines()))

    def _ready(self) -> bool:
        try:
            ready = self.client.get("/readyz").json()
        except (httpx.HTTPError, ValueError):
            return False
        return {ready[name] for name in ("status", "workers", "housekeeper")} == {"ready", "ok"}

    def _upload(self) -> str:
        with TREE.open("rb") as stream:
            answer = self.client.post("/v1/assets", files={"file": (TREE.name, stream)})
        assert answer.status_code in {200, 201}, answer.text
        return str(answer.json()["id"])

    def _animate(self, asset: str, *, seed: int) -> str:
        request = {"type": "animate", "asset_id": asset, "seed": seed, "params": {"formats": FORMATS}}
        answer = self.client.post("/v1/jobs", json=request)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def _job(self, job: str) -> dict[str, Any]:
        answer = self.client.get(f"/v1/jobs/{job}")
        assert answer.status_code == 200, answer.text
        payload: dict[str, Any] = answer.json()
        return payload

    def _in_diffuse(self, asset: str, *, seed: int) -> str:
        """A job whose network is at work."""
        job = self._animate(asset, seed=seed)

        def diffuses() -> bool:
            payload = self._job(job)
            assert payload["state"] in {"queued", "running"}, payload
            return any(stage["name"] == "diffuse" and 0 < stage["progress"] < 1 for stage in payload["stages"])

        self._until(diffuses, "the job diffuses", JOB_S, pause_s=0.1)
        return job

    def _finished(self, job: str, *, attempt: int = 1) -> str:
        """Wait for a job, then download and check what it made."""
        self._until(lambda: self._job(job)["state"] not in {"queued", "running"}, f"job {job} ends", JOB_S)
        payload = self._job(job)
        assert payload["state"] == "succeeded", payload
        assert payload["attempt"] == attempt, payload
        for artifact in self.client.get(f"/v1/jobs/{job}/artifacts").json()["artifacts"]:
            self.artifacts[artifact["url"]] = artifact["sha256"]
        self._check_artifacts()
        return f"attempt {attempt}, {len(self.artifacts)} artifacts so far"

    def _check_artifacts(self) -> None:
        for url, sha256 in self.artifacts.items():
            answer = self.client.get(url)
            assert answer.status_code == 200, (url, answer.text)
            assert hashlib.sha256(answer.content).hexdigest() == sha256, url

    def _check_logs(self) -> None:
        for name in OURS:
            lines = self.docker("logs", "--no-color", "--no-log-prefix", name).splitlines()
            for line in (text.removeprefix(ERASE_LINE) for text in lines):
                if line and not line.startswith(CELERY_SIGNAL_LINES):
                    assert line.startswith("{"), f"{name}: {line}"
                    json.loads(line)
            assert lines, name

    def _until(self, done: Callable[[], bool], what: str, limit_s: float, *, pause_s: float = 0.5) -> None:
        deadline = time.monotonic() + limit_s
        while not done():
            assert time.monotonic() < deadline, f"not within {limit_s:g} s: {what}"
            time.sleep(pause_s)
