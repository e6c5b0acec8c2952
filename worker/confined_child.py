"""Child processes that read files of strangers: the request on their stdin, lines of JSON on their stdout."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress

from pydantic import BaseModel

from dynamictree.errors import FormatError, InputError
from jobs.storage.parser_process import FOLDER, child_environment

ERRORS = {error.code: error for error in (FormatError, InputError)}
"""What a child may say of the files, by its code."""

WAIT_S = 10.0
"""For a child to end that has closed its output."""

MAX_LINE_BYTES = 16 * 2**20


@contextmanager
def answering() -> Iterator[Callable[[BaseModel], None]]:
    """In the child: gives what writes an answer as a line; whatever else is printed goes to stderr."""
    answer_to = os.dup(1)
    os.dup2(2, 1)
    with os.fdopen(answer_to, "w") as stream:

        def tell(answer: BaseModel) -> None:
            stream.write(answer.model_dump_json() + "\n")
            stream.flush()

        yield tell


def answers(module: str, request: BaseModel) -> Generator[bytes, None, None]:
    """Run `python -m module` on a request and iterate over its lines; closing ends it and the programs it runs.

    Raises:
        InputError: it ended; whoever got the last line that is needed reads no further.
    """
    with subprocess.Popen(
        [sys.executable, "-P", "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=child_environment(),
        cwd=FOLDER,
        start_new_session=True,
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            with suppress(BrokenPipeError):  # it died before it read the request
                child.stdin.write(request.model_dump_json().encode())
                child.stdin.close()
            while line := child.stdout.readline(MAX_LINE_BYTES):
                yield line
            child.wait(WAIT_S)
        finally:
            if child.returncode is None:
                os.killpg(child.pid, signal.SIGKILL)
    raise InputError(f"reading the files ended with exit code {child.returncode}; export them again, or reduce them")
