"""Engine and splat formats as jobs over HTTP: uploaded, asked for and downloaded."""

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from dynamictree.export.table import PRODUCTS
from dynamictree.formats.gltf.meshopt import compress
from dynamictree.formats.gltf.writer import GlbWriter, add_mesh
from dynamictree.formats.splat.sog import write_sog
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Format
from service.app import create_app
from tests.formats.ksplat_bytes import ksplat_bytes
from tests.service.test_assets import send, zipped
from tests.service.test_clouds import post_cloud
from tests.worker.test_attempt import give_spectrum, run
from worker.runtime import Runtime

Files = tuple[tuple[str, bytes], ...]


def sog_files() -> Files:
    """A SOG archive's files by themselves, as splat-transform writes them into a folder."""
    stream = io.BytesIO()
    write_sog(post_cloud(), stream)
    archive = zipfile.ZipFile(stream)
    return tuple((name, archive.read(name)) for name in archive.namelist())


def packed_glb() -> bytes:
    """A pipe of 200 vertices with meshopt's extension."""
    row, turn = np.divmod(np.arange(200), 10)
    angle = turn * np.pi / 5
    vertices = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), row / 10], axis=1).astype(np.float32)
    below = np.arange(190)
    beside = below - turn[:190] + (turn[:190] + 1) % 10
    faces = np.concatenate([np.stack([below, beside, below + 10], 1), np.stack([beside, beside + 10, below + 10], 1)])
    writer = GlbWriter()
    add_mesh(writer, TriangleMesh(vertices=vertices, faces=faces.astype(np.int32)))
    writer.append("nodes", {"mesh": 0})
    compress(writer)
    stream = io.BytesIO()
    writer.finish(stream)
    return stream.getvalue()


@pytest.fixture
def client(runtime: Runtime) -> Iterator[TestClient]:
    with TestClient(create_app(runtime.settings), "http://localhost") as opened:
        yield opened


def test_sog_comes_as_its_files_or_as_a_folder_in_a_zip(client: TestClient) -> None:
    files = sog_files()
    folder = (("scan.zip", zipped(*((f"scan/{name}", content) for name, content in files))),)
    sent = [send(client, *upload) for upload in (files, folder)]
    assert [response.status_code for response in sent] == [201, 201]
    one, other = (response.json() for response in sent)
    assert (one["kind"], one["summary"]["num_gaussians"]) == ("cloud", 400)
    assert other["summary"] == one["summary"]


JOBS: dict[str, tuple[tuple[str, bytes], Format, bytes]] = {
    "SOG": (("tree.sog", zipped(*sog_files())), "usd-splat", b"PXR-USDC"),
    "ksplat": (("tree.ksplat", ksplat_bytes(post_cloud(), 1)), "html-splat", b"<!doctype html>"),
    "meshopt": (("tree.glb", packed_glb()), "glb", b"EXT_meshopt_compression"),
}


@pytest.mark.parametrize("what", JOBS)
def test_a_job_on_a_new_format_writes_its_file(what: str, client: TestClient, runtime: Runtime, tmp_path: Path) -> None:
    """Which other people's readers open: tests/export and tests/formats."""
    upload, name, sign = JOBS[what]
    asset = send(client, upload).json()
    assert asset["kind"] == ("mesh" if what == "meshopt" else "cloud")
    params = {"formats": [name], "glb_compression": "meshopt", "joints": 32, "num_frames": 4, "loop": False}
    request = {"type": "animate", "asset_id": asset["id"], "params": params | {"shot": {"side_px": 64}}}
    job_id = client.post("/v1/jobs", json=request).json()["id"]
    run(runtime, give_spectrum(runtime, runtime.store.job(job_id), tmp_path))
    assert client.get(f"/v1/jobs/{job_id}").json()["state"] == "succeeded"
    listed = client.get(f"/v1/jobs/{job_id}/artifacts").json()["artifacts"]
    [entry] = [entry for entry in listed if entry["name"] == PRODUCTS[name].file_name]
    downloaded = client.get(entry["url"])
    assert downloaded.headers["content-type"] == entry["media_type"] == PRODUCTS[name].media_type
    assert downloaded.headers["content-disposition"].endswith(f"''{entry['name']}")
    assert len(downloaded.content) == entry["bytes"]
    assert sign in downloaded.content
