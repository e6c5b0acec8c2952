"""`service.testing`, as tests of third parties use it."""

import pytest

from service.testing import client
from tests.service.test_assets import send
from tests.service.test_authentication import TREE


@pytest.mark.slow
def test_a_third_party_uploads_polls_downloads_and_is_refused() -> None:
    with client() as http:
        asset = send(http, TREE).json()
        job = http.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset["id"]}).json()
        while job["state"] in ("queued", "running"):
            job = http.get(f"/v1/jobs/{job['id']}", headers={"Prefer": "wait=10"}).json()
        assert job["state"] == "succeeded", job["error"]
        [artifact] = http.get(f"/v1/jobs/{job['id']}/artifacts").json()["artifacts"]
        assert len(http.get(artifact["url"]).content) == artifact["bytes"]
        assert http.post("/v1/jobs", json={"type": "none"}).status_code == 422
        with http.websocket_connect("/v1/interact/stream") as socket:
            socket.send_json({"type": "open", "spectrum_id": job["id"]})
            assert socket.receive_json()["type"] == "problem"
