"""Kills parts of a running service at random points of random stages, and looks whether a job is lost or done twice.

`python -m tests.faults.kills --kills 200 --seed 1`: PostgreSQL, Redis, API, two workers and a housekeeper as processes,
clients that create, poll and cancel, messages delivered twice. Prints a line a kill and a summary; exits with 1 if
a law broke.
"""

import argparse
import os
import random
import re
import shutil
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import httpx
import psutil
import sqlalchemy as sa
from kombu.exceptions import OperationalError

from jobs.database import tables as t
from jobs.database.engine import open_engine
from jobs.lifecycle.maintenance import RUN_JOB
from tests import servers
from tests.faults.conftest import SHORT
from tests.faults.drill import parse, tell
from tests.faults.shapes import bumpy_sphere

ENDED = {"succeeded", "failed", "canceled"}
STAGES = ("voxelize", "diffuse", "animate")
VICTIMS = {"worker": 6, "pool": 5, "heartbeat": 1, "api": 5, "redis": 4, "housekeeper": 2, "redis+worker": 2}
"""Who is killed, and how often in comparison."""

BETWEEN_SHARE = 0.1
"""Kills that wait for no stage: while a worker starts, while a job is sent or handed out."""

PATIENCE_S = 60.0
"""How long a kill waits for a stage of its choice."""

LAWS_S = 600.0
"""After the last kill everything that was accepted must have ended within so long."""

_PUBLISHED = re.compile(r"stage (\w+) of job (\w+) published")


@dataclass(kw_only=True)
class Ledger:
    """What clients were promised, and what they saw."""

    accepted: dict[str, str] = field(default_factory=dict)  # client's name → job's URL
    ended: dict[str, dict[str, object]] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)
    answers: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)


class Client(threading.Thread):
    """Makes one job after the other and sees each to its end, whatever happens to the API meanwhile."""

    def __init__(self, url: str, ledger: Ledger, *, number: int, seed: int, stopped: threading.Event) -> None:
        super().__init__(name=f"client-{number}", daemon=True)
        self.http = httpx.Client(base_url=url, timeout=20)
        self.ledger, self.number, self.stopped = ledger, number, stopped
        self.rng = random.Random(f"{seed}-{number}")

    def run(self) -> None:
        turn = 0
        asset_id = ""
        while not self.stopped.is_set():
            if turn % 2 == 0:
                mesh = bumpy_sphere(24 + self.rng.randrange(8), seed=self.rng.randrange(1 << 30), width=0.05)
                asset_id = self.ask("POST", "/v1/assets", files={"file": ("tree.obj", mesh)})["id"]
            name = f"client-{self.number}-{turn}"
            kind = self.rng.choice(list(PARAMS))
            body = {"type": kind, "asset_id": asset_id, "seed": turn, "params": PARAMS[kind]}
            response = self.ask("POST", "/v1/jobs", json=body, headers={"Idempotency-Key": name})
            url = f"/v1/jobs/{response['id']}"
            with self.ledger.lock:
                self.ledger.accepted[name] = url
            if self.rng.random() < 0.1:
                self.stopped.wait(self.rng.random() * 3)
                self.ask("POST", url + "/cancel", allowed=(202, 409))
            self.see_through(name, url)
            turn += 1

    def see_through(self, name: str, url: str) -> None:
        while True:
            job = self.ask("GET", url)
            if job["state"] in ENDED:
                with self.ledger.lock:
                    self.ledger.ended[name] = job
                return
            time.sleep(0.5)

    def ask(self, method: str, path: str, *, allowed: tuple[int, ...] = (200, 201, 202), **content: object) -> dict:
        """Ask until there is an answer; a 5xx other than 503 is a broken law."""
        while True:
            try:
                response = self.http.request(method, path, **content)
            except httpx.TransportError:
                self.ledger.answers["no answer"] += 1
                time.sleep(0.2)
                continue
            self.ledger.answers[str(response.status_code)] += 1
            if response.status_code in allowed:
                return response.json()
            if response.status_code != 503:
                self.ledger.broken.append(f"{method} {path}: {response.status_code} {response.text[:300]}")
            time.sleep(0.5)


PARAMS: dict[str, dict[str, object]] = {
    "voxelize": {"resolution": 256},
    "diffuse": {"num_steps": 3},
    "animate": {"num_steps": 3, "formats": ["motion"]},
}
PRODUCTS = {
    "voxelize": {"tree.voxels.safetensors"},
    "diffuse": {"tree.voxels.safetensors", "tree.spectrum.safetensors"},
}
PRODUCTS["animate"] = PRODUCTS["diffuse"] | {"motion.safetensors", "preview.png", "still.webp"}


@dataclass(kw_only=True)
class Murderer:
    """Chooses who is killed and when, and starts them again."""

    parts: dict[str, servers.Server]
    engine: sa.Engine
    rng: random.Random
    kills: Counter[str] = field(default_factory=Counter)
    stages: Counter[str] = field(default_factory=Counter)
    duplicates: int = 0

    def strike(self) -> str:
        """One kill, at a random point of a random stage."""
        victim = self.rng.choices(list(VICTIMS), list(VICTIMS.values()))[0]
        stage = self.rng.choice(STAGES)
        owner = None if self.rng.random() < BETWEEN_SHARE else self.await_stage(stage)
        self.stages[stage if owner else "between"] += 1
        time.sleep(self.rng.random() * 0.6)
        for part in victim.split("+"):
            self.kill(part, owner)
        self.kills[victim] += 1
        return f"{victim} in {stage if owner else 'between stages'}"

    def await_stage(self, stage: str) -> int | None:
        """The process that runs this stage; None if none does for a while."""
        running = sa.select(t.jobs.c.lease_owner).join(t.stages, t.stages.c.job_id == t.jobs.c.id)
        running = running.where((t.stages.c.name == stage) & (t.stages.c.state == "running"))
        running = running.where(t.jobs.c.lease_owner.is_not(None) & (t.jobs.c.lease_until > sa.bindparam("now")))
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            with self.engine.connect() as connection:
                owner = connection.execute(running.limit(1), {"now": time.time() + 1}).scalar_one_or_none()
            if owner is not None:
                return int(owner.rsplit(":", 1)[1])
            time.sleep(0.08)
        return None

    def kill(self, part: str, owner: int | None) -> None:
        if part in ("api", "redis", "housekeeper"):
            self.parts[part].kill()
            time.sleep(self.rng.random() * 2)
            self.parts[part].start(wait=False)
            return
        worker = self.worker_of(owner)
        if part == "worker" or owner is None:
            worker.kill()
            worker.start(wait=False)
            return
        with suppress(psutil.NoSuchProcess):
            process = psutil.Process(owner)
            if part == "heartbeat":
                beating = (child for child in process.children() if "worker.heartbeat" in child.cmdline())
                process = next(beating, process)  # itself where none beats yet
            process.send_signal(signal.SIGKILL)

    def worker_of(self, owner: int | None) -> servers.Server:
        workers = [part for name, part in self.parts.items() if name.startswith("worker")]
        for worker in workers:
            assert worker.process is not None
            with suppress(psutil.NoSuchProcess, ProcessLookupError):
                if owner is not None and os.getpgid(owner) == worker.process.pid:
                    return worker
        return self.rng.choice(workers)

    def deliver_twice(self) -> None:
        """Send a message that was sent before, for a job in whatever state."""
        from worker.app import app  # reads the environment, so not before it is set

        with self.engine.connect() as connection:
            query = sa.select(t.jobs.c.id, t.jobs.c.attempt).order_by(t.jobs.c.id.desc()).limit(20)
            rows = connection.execute(query).all()
        if not rows:
            return
        row = self.rng.choice(rows)
        with suppress(OSError, OperationalError):
            app.send_task(RUN_JOB, args=(row.id, row.attempt), queue="cpu", retry=False)
            self.duplicates += 1

    def revive(self) -> None:
        """Start what ended by itself."""
        for part in self.parts.values():
            assert part.process is not None
            if part.process.poll() is not None:
                part.start(wait=False)


def broken_laws(ledger: Ledger, engine: sa.Engine, http: httpx.Client, logs: Iterator[str]) -> list[str]:
    """What must hold once everything has ended."""
    broken = list(ledger.broken)
    with engine.connect() as connection:
        states = {row.id: row for row in connection.execute(sa.select(t.jobs))}
        keys = Counter(row.client_key for row in states.values())
        left = connection.execute(sa.select(sa.func.count()).select_from(t.outbox)).scalar_one()
    broken += [f"{key} means {count} jobs" for key, count in keys.items() if count > 1]
    broken += [f"job {row.id} has not ended: {row.state}" for row in states.values() if row.state not in ENDED]
    broken += [f"{left} messages are left in the outbox"] if left else []
    broken += [f"{name} was accepted and has not ended" for name in ledger.accepted if name not in ledger.ended]
    for name, seen in ledger.ended.items():
        now = states.get(str(seen["id"]))
        if now is None or now.state != seen["state"]:
            broken.append(f"{name} was {seen['state']} and is {None if now is None else now.state}")
        if seen["state"] not in ("succeeded", "canceled"):
            broken.append(f"{name} has {seen['state']}: {seen['error']}")
        wanted = PRODUCTS[str(seen["type"])] if seen["state"] == "succeeded" else None
        broken += broken_artifacts(http, ledger.accepted[name], wanted)
    published = Counter(match.groups() for text in logs for match in _PUBLISHED.finditer(text))
    broken += [f"stage {stage} of job {job} was published {n} times" for (stage, job), n in published.items() if n > 1]
    return broken


def broken_artifacts(http: httpx.Client, url: str, wanted: set[str] | None) -> list[str]:
    manifest = http.get(url + "/artifacts").json()
    names = [artifact["name"] for artifact in manifest["artifacts"]]
    twice = len(set(names)) < len(names)
    broken = [f"{url} offers {names}"] if twice or (wanted is not None and set(names) != wanted) else []
    for artifact in manifest["artifacts"]:
        content = http.get(artifact["url"]).content
        if (len(content), sha256(content).hexdigest()) != (artifact["bytes"], artifact["sha256"]):
            broken.append(f"{url}: {artifact['name']} differs from its hash")
    return broken


def start_parts(folder: Path, running: ExitStack) -> tuple[dict[str, servers.Server], str, sa.Engine]:
    database, database_url = servers.postgres(folder)
    running.callback(shutil.rmtree, database.cwd or "")
    redis_server, redis_url = servers.valkey(folder)
    environment = SHORT | {
        "DYNAMICTREE_DATABASE_URL": database_url,
        "DYNAMICTREE_REDIS_URL": redis_url,
        "DYNAMICTREE_STATE_DIR": str(folder / "state"),
        "DYNAMICTREE_MAX_LOST_ATTEMPTS": "20",
    }
    os.environ.update(environment)  # for the messages that are delivered twice
    front, url = servers.api(folder, environment)
    parts = {"redis": redis_server, "api": front, "housekeeper": servers.housekeeper(folder, environment)}
    parts |= {f"worker {name}": servers.worker(folder, environment, name) for name in ("one", "two")}
    for part in (database, *parts.values()):
        part.start()
        running.callback(part.stop, 10)
    engine = open_engine(database_url)
    running.callback(engine.dispose)
    return parts, url, engine


def run(folder: Path, *, kills: int, seed: int, clients: int, minutes: float) -> dict[str, object]:
    """Kill so often; what happened, and which laws broke."""
    began = time.monotonic()
    with ExitStack() as running:
        parts, url, engine = start_parts(folder, running)
        ledger, stopped = Ledger(), threading.Event()
        crowd = [Client(url, ledger, number=n, seed=seed, stopped=stopped) for n in range(clients)]
        for client in crowd:
            client.start()
        murderer = Murderer(parts=parts, engine=engine, rng=random.Random(seed))
        while murderer.kills.total() < kills and time.monotonic() - began < minutes * 60:
            what = murderer.strike()
            murderer.deliver_twice()
            murderer.revive()
            report = {"kill": murderer.kills.total(), "what": what, "seconds": round(time.monotonic() - began)}
            tell(report | {"accepted": len(ledger.accepted), "ended": len(ledger.ended)})
        killed_s = time.monotonic() - began
        stopped.set()
        deadline = time.monotonic() + LAWS_S
        while any(client.is_alive() for client in crowd) and time.monotonic() < deadline:
            murderer.revive()
            time.sleep(0.5)
        logs = (path.read_text(errors="replace") for path in folder.glob("worker-*.log"))
        with httpx.Client(base_url=url, timeout=30) as http:
            broken = broken_laws(ledger, engine, http, logs)
        attempts = Counter(job["attempt"] for job in ledger.ended.values())
        return {
            "kills": murderer.kills.total(),
            "victims": dict(murderer.kills),
            "stages": dict(murderer.stages),
            "duplicates": murderer.duplicates,
            "jobs": len(ledger.accepted),
            "states": dict(Counter(str(job["state"]) for job in ledger.ended.values())),
            "attempts": {str(k): v for k, v in sorted(attempts.items())},  # type: ignore[type-var]
            "answers": dict(ledger.answers),
            "seed": seed,
            "seconds": round(killed_s),
            "broken": broken[:50],
            "num_broken": len(broken),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--clients", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=30, help="kill no more after so long")
    given, folder = parse(parser, prefix="faults-")
    report = run(folder, kills=given.kills, seed=given.seed, clients=given.clients, minutes=given.minutes)
    tell(report)
    if report["num_broken"] or report["kills"] != given.kills:
        sys.exit(f"{report['num_broken']} laws broke, {report['kills']} of {given.kills} kills; logs are in {folder}")
    if given.keep is None:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
