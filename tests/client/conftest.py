"""A whole service of its own, with its worker."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.servers import free_port


@pytest.fixture(scope="session")
def hook_port() -> int:
    """A port of this machine that the service may send webhooks to."""
    return free_port()


@pytest.fixture(scope="session")
def url(tmp_path_factory: pytest.TempPathFactory, hook_port: int) -> Iterator[str]:
    """Address of `dynamictree serve` with its embedded Redis, SQLite and local folder."""
    folder = tmp_path_factory.mktemp("served")
    port = free_port()
    command = [sys.executable, "-m", "dynamictree.cli", "serve", "--host", "127.0.0.1", "--port", str(port)]
    with (folder / "serve.log").open("w") as log:
        hosts = {"DYNAMICTREE_OUTBOUND_HOSTS": f'["127.0.0.1:{hook_port}"]'}
        process = subprocess.Popen(
            [*command, "--state-dir", str(folder / "state")],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=os.environ | hosts,
        )
        with process:
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith("ready "):
                    yield line.split()[1]
                    break
            process.send_signal(signal.SIGTERM)
            process.stdout.read()
            process.wait(timeout=60)
    assert process.returncode == 0, (folder / "serve.log").read_text()[-2000:]
