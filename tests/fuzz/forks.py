"""A parser that has imported everything, and forks for each file: a file may do to its own process what it likes."""

import json
import os
import resource
import select
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from dynamictree.errors import InputError
from service.http.problems import KINDS, ProblemError

MEMORY_BYTES = 1 << 30
"""What one file may take on top of the parser itself."""

CPU_S = 5
WALL_S = 60.0


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one file. `fault` is empty where it was read or refused as it should be."""

    verdict: str  # read, refused, or a fault's kind
    detail: str
    seconds: float
    peak_mib: float  # on top of the process that forks

    @property
    def faulty(self) -> bool:
        return self.verdict not in ("read", "refused")


def attempt(read: Callable[[bytes], object], content: bytes, *, cpu_s: int = CPU_S) -> Outcome:
    """Read in a fork, under limits."""
    begun = time.monotonic()
    before_mib = _resident_bytes() / 2**20
    answer, answer_to = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(answer)
        _child(read, content, answer_to, cpu_s)
    os.close(answer_to)
    report = b""
    if select.select([answer], [], [], WALL_S)[0]:
        report = os.read(answer, 65536)
    else:
        os.kill(pid, signal.SIGKILL)
    os.close(answer)
    _, status, used = os.wait4(pid, 0)
    seconds = time.monotonic() - begun
    verdict, detail = json.loads(report) if report else _ended(status, seconds)
    return Outcome(verdict=verdict, detail=detail, seconds=seconds, peak_mib=used.ru_maxrss / 1024 - before_mib)


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _child(read: Callable[[bytes], object], content: bytes, answer_to: int, cpu_s: int) -> None:
    now_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now_bytes + MEMORY_BYTES,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    try:
        read(content)
        report = ("read", "")
    except InputError as error:
        report = ("refused", f"{type(error).__name__}: {error}"[:300])
    except ProblemError as error:
        report = ("refused" if KINDS[error.code].status < 500 else "5xx", f"{error.code}: {error.detail}"[:300])
    except BaseException as error:  # noqa: BLE001 (this is what is looked for)
        report = (type(error).__name__, traceback.format_exc()[-3000:])
    os.write(answer_to, json.dumps(report).encode())
    os._exit(0)


def _ended(status: int, seconds: float) -> tuple[str, str]:
    if seconds >= WALL_S:
        return "hang", f"no answer within {WALL_S:g} s"
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        kind = "hang" if number in (signal.SIGXCPU, signal.SIGKILL) else "crash"
        return kind, signal.Signals(number).name
    return "crash", f"exit status {os.waitstatus_to_exitcode(status)}"
