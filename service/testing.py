"""Test client of a real service for tests of other programs: `from service.testing import client`; see docs/jobs.md."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from fastapi.testclient import TestClient

from jobs.settings import Settings
from service.app import create_app


@contextmanager
def client() -> Iterator[TestClient]:
    """Context manager that yields a client of a real service without keys, whose jobs run without Redis.

    Its state is a temporary folder; a separate process runs the jobs, one after another.
    """
    with TemporaryDirectory(prefix="dynamictree-") as folder:
        environment = os.environ | {"DYNAMICTREE_STATE_DIR": folder, "DYNAMICTREE_LOG_LEVEL": "ERROR"}
        # starlette sends the Host testserver for WebSockets, whatever the base URL
        settings = Settings(state_dir=Path(folder), hosts=("testserver",))
        worker = subprocess.Popen([sys.executable, "-m", "worker.inline"], stdin=subprocess.PIPE, env=environment)
        try:
            with TestClient(create_app(settings), "http://localhost") as opened:
                yield opened
        finally:
            worker.communicate()
