"""The whole service as a user starts it, with short leases."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import httpx
import pytest

from jobs.lifecycle.maintenance import lease_names
from jobs.settings import Settings
from jobs.store import Store
from tests.servers import wait_for

SHORT = {
    "DYNAMICTREE_LEASE_S": "3",
    "DYNAMICTREE_HEARTBEAT_S": "0.5",
    "DYNAMICTREE_VISIBILITY_TIMEOUT_S": "15",
    "DYNAMICTREE_RESTORE_INTERVAL_S": "2",
    "DYNAMICTREE_REAPER_INTERVAL_S": "0.2",
    "DYNAMICTREE_HOUSEKEEPER_LEASE_S": "3",
    "DYNAMICTREE_RESEND_S": "5",
    "DYNAMICTREE_PROGRESS_INTERVAL_S": "0",
    "DYNAMICTREE_MIN_FREE_BYTES": "0",
}


@dataclass(kw_only=True)
class Running:
    """A service that runs somewhere, and what every test asks of it."""

    client: httpx.Client

    def upload(self, name: str, content: bytes) -> str:
        response = self.client.post("/v1/assets", files={"file": (name, content)})
        assert response.status_code in {200, 201}, response.text
        return str(response.json()["id"])

    def create(self, **body: object) -> str:
        response = self.client.post("/v1/jobs", json=body)
        assert response.status_code == 202, response.text
        return response.headers["Location"]

    def finish(self, url: str, timeout_s: float = 120) -> dict[str, object]:
        """Poll a job until it has ended."""

        def ended() -> dict[str, object] | None:
            job: dict[str, object] = self.client.get(url).json()
            return job if job["state"] in {"succeeded", "failed", "canceled"} else None

        return wait_for(ended, f"the end of {url}", timeout_s)

    def whole_artifacts(self, url: str) -> list[str]:
        """Names of what a job has made: every name once, every file whole, every hash right."""
        manifest = self.client.get(url + "/artifacts").json()
        names = [artifact["name"] for artifact in manifest["artifacts"]]
        assert len(set(names)) == len(names)
        assert manifest["complete"]
        for artifact in manifest["artifacts"]:
            content = self.client.get(artifact["url"]).content
            assert (len(content), sha256(content).hexdigest()) == (artifact["bytes"], artifact["sha256"])
            half, etag = len(content) // 2, f'"{artifact["sha256"]}"'
            rest = self.client.get(artifact["url"], headers={"Range": f"bytes={half}-", "If-Range": etag})
            assert (rest.status_code, rest.content) == (206, content[half:])
        return names


@dataclass(kw_only=True)
class Service(Running):
    """`dynamictree serve`."""

    process: subprocess.Popen[str]
    settings: Settings

    def worker_pid(self) -> int:
        """The process in which a task runs."""
        with closing(Store.open(self.settings.resolved_database_url)) as store:
            names = wait_for(lambda: lease_names(store, "worker:"), "a worker")
        return int(names[-1].rsplit(":", 1)[1])


def start(state_dir: Path, **environment: str) -> Service:
    command = [sys.executable, "-m", "dynamictree.cli", "serve", "--port", "0", "--state-dir", str(state_dir)]
    log = (state_dir.parent / "serve.log").open("ab")
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=log, text=True, env=os.environ | SHORT | environment
    )
    log.close()
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, (state_dir.parent / "serve.log").read_text()[-4000:]
    settings = Settings(state_dir=state_dir)
    client = httpx.Client(base_url=line.removeprefix("ready ").strip(), timeout=30)
    return Service(process=process, client=client, settings=settings)


def stop(service: Service, wait_s: float = 60) -> int:
    service.client.close()
    service.process.send_signal(signal.SIGTERM)
    code = service.process.wait(wait_s)
    assert service.process.stdout is not None
    service.process.stdout.close()
    return code


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    running = start(tmp_path_factory.mktemp("service") / "state")
    yield running
    assert stop(running) == 0
