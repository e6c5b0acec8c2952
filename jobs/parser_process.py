"""Call the child process that reads uploaded files (`worker.parse`): its request and its answer."""

import asyncio
import logging
import os
import signal
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from pydantic import BaseModel, ConfigDict, ValidationError

from jobs.settings import Settings
from jobs.states import AssetKind

logger = logging.getLogger(__name__)

CHILD = ("-P", "-m", "worker.parse")
"""-P: neither the current folder nor that of a script is searched for modules."""

FOLDER = "/"
"""The child's current folder; nobody's files lie beside it."""

MAX_ANSWER_BYTES = 64 * 1024
MAX_ERROR_BYTES = 4096
INHERITED = ("PATH", "LANG", "LD_LIBRARY_PATH", "PYTHONHOME", "PYTHONDONTWRITEBYTECODE", "TMPDIR")
"""Of the environment. The child gets no credentials, no home, and no PYTHONPATH (it may name a user folder)."""


class ParseRequest(BaseModel):
    """Files that the child reads: models first, then their companions."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: AssetKind  # its bytes decide whether a model is a mesh or a cloud
    num_models: int = 1
    names: tuple[str, ...]
    paths: tuple[Path, ...]
    prepared: Path  # where the mesh or cloud goes, in metres and +Z up
    reading: Mapping[str, str | float | None] = {}  # fields of `Reading`
    memory_bytes: int
    cpu_s: int


class ParseAnswer(BaseModel):
    """Answer of the child: a summary, or why the files cannot be used."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: AssetKind | None = None
    summary: Mapping[str, str | float | int | list[float] | list[dict[str, str | int | float]] | None] | None = None
    code: str | None = None
    message: str = ""


def child_environment() -> dict[str, str]:
    """Environment variables of the child process."""
    inherited = {name: value for name, value in os.environ.items() if name in INHERITED or name.startswith("LC_")}
    return inherited | {"HOME": FOLDER, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


async def parse(request: ParseRequest, settings: Settings) -> ParseAnswer:
    """Run the child. Whatever happens to it, there is an answer, and no process is left."""
    with tempfile.TemporaryFile() as errors:
        child = await asyncio.create_subprocess_exec(
            sys.executable,
            *CHILD,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            env=child_environment(),
            cwd=FOLDER,
            start_new_session=True,
        )
        try:
            # a child that sleeps uses no CPU time, so the wall clock is bounded too
            sent = request.model_dump_json().encode()
            answered, _ = await asyncio.wait_for(child.communicate(sent), settings.parser_cpu_s * 2)
        except TimeoutError:
            answered = b""
        finally:
            if child.returncode is None:
                os.killpg(child.pid, signal.SIGKILL)
                await child.wait()
        try:
            return ParseAnswer.model_validate_json(answered[:MAX_ANSWER_BYTES])
        except ValidationError:
            return _no_answer(child.returncode, errors, settings)


def _no_answer(returncode: int | None, errors: IO[bytes], settings: Settings) -> ParseAnswer:
    errors.seek(max(errors.seek(0, os.SEEK_END) - MAX_ERROR_BYTES, 0))
    stderr_text = errors.read().decode(errors="replace")
    if returncode == 1 and '  File "' in stderr_text:  # a traceback; a library without memory ends with 1 too
        logger.error("the parser failed:\n%s", stderr_text)
        return ParseAnswer(code="internal-error", message="The cause was logged.")
    ended = f"signal {-returncode}" if returncode is not None and returncode < 0 else f"exit code {returncode}"
    allowed = f"{settings.parser_cpu_s} s of one core and {settings.parser_memory_bytes:,} bytes of memory"
    return ParseAnswer(
        code="input-too-costly",
        message=f"reading the file ended with {ended}; {allowed} are allowed; decimate or repair it",
    )
