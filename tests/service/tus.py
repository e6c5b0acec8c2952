"""Requests of the tus protocol, as a client sends them."""

import base64

from fastapi.testclient import TestClient

TUS = {"Tus-Resumable": "1.0.0"}
BYTES = TUS | {"Content-Type": "application/offset+octet-stream"}


def metadata(**values: str) -> str:
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in values.items())


def begin(client: TestClient, length: int, **values: str) -> str:
    sent = TUS | {"Upload-Length": str(length), "Upload-Metadata": metadata(**values)}
    response = client.post("/v1/uploads", headers=sent)
    assert response.status_code == 201, response.text
    assert response.headers["Tus-Resumable"] == "1.0.0"
    return str(response.headers["Location"])


def append(client: TestClient, url: str, offset: int, content: bytes, **headers: str) -> object:
    return client.patch(url, content=content, headers=BYTES | {"Upload-Offset": str(offset)} | headers)


def whole(client: TestClient, content: bytes, **values: str) -> str:
    """An upload in one request, as `creation-with-upload` has it."""
    sent = BYTES | {"Upload-Length": str(len(content)), "Upload-Metadata": metadata(**values)}
    response = client.post("/v1/uploads", headers=sent, content=content)
    assert (response.status_code, response.headers["Upload-Offset"]) == (201, str(len(content))), response.text
    return str(response.headers["Location"]).rpartition("/")[2]
