"""/llms.txt names only what the service has, and its bodies are accepted."""

import json
import re
from pathlib import Path

from fastapi.testclient import TestClient

from jobs.records import AssetRecord

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "web" / "llms.txt").read_text()


def test_it_is_served(client: TestClient) -> None:
    got = client.get("/llms.txt")
    assert (got.status_code, got.text) == (200, TEXT)
    assert got.headers["content-type"] == "text/plain; charset=utf-8"


def test_every_operation_and_link_is_there(client: TestClient) -> None:
    paths = json.loads((ROOT / "openapi" / "openapi.json").read_text())["paths"]
    named = re.findall(r"`(GET|POST|DELETE) (/[\w/{}-]+)`", TEXT)
    assert len(named) >= 8
    for method, path in named:
        assert method.lower() in paths[path], (method, path)
    for address in re.findall(r"\]\((/[^)]*)\)", TEXT):
        assert client.get(address).status_code == 200, address


def test_its_job_is_accepted(client: TestClient, asset: AssetRecord) -> None:
    [body] = re.findall(r'`(\{"type": "animate".*?\})`', TEXT)
    response = client.post("/v1/jobs", json=json.loads(body.replace("ID", f'"{asset.id}"')))
    assert response.status_code == 202, response.text
