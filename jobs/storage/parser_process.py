"""Call the process that reads uploaded files (`worker.parse`): its request and its response."""

import asyncio
import atexit
import logging
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from cachetools import TLRUCache, cached
from pydantic import BaseModel, ConfigDict, ValidationError

from jobs.settings import Settings
from jobs.states import AssetKind

logger = logging.getLogger(__name__)

SERVER = ("-P", "-m", "worker.parse_server")
"""Command line of the server. -P: no modules are imported from the current folder."""

FOLDER = "/"
"""Current folder of the child, which holds no files of users."""

END_S = 5.0  # time for the server to end its children [s]
MAX_ANSWER_BYTES = 64 * 1024
INHERITED = ("PATH", "LANG", "LD_LIBRARY_PATH", "PYTHONHOME", "PYTHONDONTWRITEBYTECODE", "TMPDIR")
"""Environment variables of the child: no credentials, no home, and no PYTHONPATH (it may name a user folder)."""


class ParseRequest(BaseModel):
    """Files that the child reads: models first, then their companions."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: AssetKind  # the content decides whether a model is a mesh or a cloud
    num_models: int = 1
    names: tuple[str, ...]
    paths: tuple[Path, ...]
    prepared: Path  # output file for the mesh or cloud, in metres and +Z up
    reading: Mapping[str, str | float | None] = {}  # fields of `Reading`
    memory_bytes: int
    cpu_s: int


class ParseAnswer(BaseModel):
    """Response of the child: a summary, or why the files cannot be used; our own errors with their traceback."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: AssetKind | None = None
    summary: Mapping[str, str | float | int | list[float] | list[dict[str, str | int | float]] | None] | None = None
    code: str | None = None
    message: str = ""
    lacks: tuple[str, ...] = ()  # confinements that this machine does not support


@cache
def _warn_of(lacks: tuple[str, ...]) -> None:
    logger.warning("uploads are read without %s, which this kernel or container lacks", " and ".join(lacks))


def child_environment() -> dict[str, str]:
    """Return the environment variables of the child process."""
    inherited = {name: value for name, value in os.environ.items() if name in INHERITED or name.startswith("LC_")}
    return inherited | {"HOME": FOLDER, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class NoServerError(Exception):
    """The process that reads uploads cannot be started, or ends by itself."""


class _Server:
    """The process that forks per upload (`worker.parse_server`). It starts on demand and ends with this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self.control: socket.socket | None = None  # None before the first use

    def read(self, connection: socket.socket) -> None:
        """Let the server read an upload; request and response use the connection."""
        with self._lock:
            try:
                socket.send_fds(self.control or self._started(), [b"u"], [connection.fileno()])
            except OSError:  # the server has ended
                socket.send_fds(self._started(), [b"u"], [connection.fileno()])

    def end(self) -> None:
        """End the server and its forks."""
        if self._process is not None and self.control is not None:
            self.control.close()
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _started(self) -> socket.socket:
        """Start the server again and return its control socket."""
        self.end()
        self.control, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, *SERVER],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                env=child_environment(),
                cwd=FOLDER,
                start_new_session=True,
            )
        return self.control


server = _Server()
atexit.register(server.end)


async def parse(request: ParseRequest, settings: Settings) -> ParseAnswer:
    """Parse files in the child process. It always ends, and there is always a response."""
    try:
        content = await _content(request)
        if content == b"":  # no exit code: the server has ended
            request.prepared.unlink(missing_ok=True)
            content = await _content(request)
        if content == b"":
            raise NoServerError from EOFError("it ended before it answered, twice")
    except NoServerError as error:
        logger.error("no process can be started that reads uploads: %s", error.__cause__)
        return ParseAnswer(code="overloaded", message="no process can be started that reads the file")
    answered, _, status = (content or b"").rpartition(b"\n")
    try:
        answer = ParseAnswer.model_validate_json(answered)
    except ValidationError:
        return _no_answer(int(status) if status.removeprefix(b"-").isdigit() else None, settings)
    if answer.lacks:
        _warn_of(answer.lacks)  # logged once
    if answer.code == "internal-error":
        logger.error("the parser failed:\n%s", answer.message)
        return ParseAnswer(code=answer.code, message="The cause was logged.")
    return answer


@cached(TLRUCache(maxsize=4, ttu=lambda _, works, now: now + (60.0 if works else 5.0)), lock=threading.Lock())  # [s]
def reader_works(settings: Settings) -> bool:
    """Return whether the child process read a small file; each check costs a process, so results are cached."""
    with suppress(OSError), TemporaryDirectory(prefix="check-", dir=settings.scratch_dir) as folder:
        tree = Path(folder) / "tree.obj"
        tree.write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n")
        limits = {"memory_bytes": settings.parser_memory_bytes, "cpu_s": settings.parser_cpu_s}
        request = ParseRequest(kind="mesh", names=(tree.name,), paths=(tree,), prepared=Path(folder, "mesh"), **limits)
        return asyncio.run(parse(request, settings)).summary is not None
    return False


async def _content(request: ParseRequest) -> bytes | None:
    """Return the output for a request: the response, then a line with the exit code; None after a timeout.

    Raises:
        NoServerError: the server cannot be started.
    """
    ours, theirs = socket.socketpair()
    with theirs:
        try:
            await asyncio.to_thread(server.read, theirs)
        except OSError as error:
            ours.close()
            raise NoServerError from error
    reader, writer = await asyncio.open_unix_connection(sock=ours)
    try:
        writer.write(request.model_dump_json().encode())
        writer.write_eof()
        # a process that sleeps uses no CPU time, so the wall clock is bounded too
        return await asyncio.wait_for(_all_of(reader), 2 * request.cpu_s)
    except TimeoutError:
        return None
    except ConnectionError:
        return b""
    finally:
        writer.close()  # the process is ended if it still runs


async def _all_of(reader: asyncio.StreamReader) -> bytes:
    content = b""
    while piece := await reader.read(MAX_ANSWER_BYTES):
        content = (content + piece)[-MAX_ANSWER_BYTES:]
    return content


def _no_answer(returncode: int | None, settings: Settings) -> ParseAnswer:
    ended = "a timeout" if returncode is None else f"{'signal' if returncode < 0 else 'exit code'} {abs(returncode)}"
    allowed = f"{settings.parser_cpu_s} s of one core and {settings.parser_memory_bytes:,} bytes of memory"
    message = f"reading the file ended with {ended}; {allowed} are allowed; decimate or repair it"
    return ParseAnswer(code="input-too-costly", message=message)
