"""Engine and splat formats as jobs over HTTP: uploaded, asked for and downloaded."""

import io
import zipfile
from collections.abc import Iterator

import numpy as np
import pytest
from fastapi.testclient import TestClient

from dynamictree.export.table import PRODUCTS
from dynamictree.formats.gltf.meshopt import compress
from dynamictree.formats.gltf.writer import GlbWriter, add_mesh
from dynamictree.formats.splat.sog import write_sog
from service.app import create_app
from tests.formats.ksplat_bytes import ksplat_bytes
from tests.formats.meshes import trunk_and_crown, written
from tests.service.test_assets import send, zipped
from tests.service.test_clouds import post_cloud
from tests.worker.test_attempt import give_spectrum, run
from worker.runtime import Runtime

Files = tuple[tuple[str, bytes], ...]


def sog_files() -> Files:
    """A SOG archive's files by themselves, as splat-transform writes them into a folder."""
    archive = zipfile.ZipFile(io.BytesIO(written(write_sog, post_cloud())))
    return tuple((name, archive.read(name)) for name in archive.namelist())


def packed_glb() -> bytes:
    """A tree with meshopt's extension."""
    writer = GlbWriter()
    add_mesh(writer, trunk_and_crown(np.random.default_rng(0)))
    writer.append("nodes", {"mesh": 0})
    compress(writer)
    return written(writer.finish)


@pytest.fixture
def client(runtime: Runtime) -> Iterator[TestClient]:
    with TestClient(create_app(runtime.settings), "http://localhost") as opened:
        yield opened


def test_sog_comes_as_its_files_or_as_a_folder_in_a_zip_and_ksplat_as_one_file(client: TestClient) -> None:
    files = sog_files()
    folder = (("scan.zip", zipped(*((f"scan/{name}", content) for name, content in files))),)
    sent = [send(client, *upload) for upload in (files, folder)]
    assert [response.status_code for response in sent] == [201, 201]
    one, other = (response.json() for response in sent)
    assert (one["kind"], one["summary"]["num_gaussians"]) == ("cloud", 400)
    assert other["summary"] == one["summary"]
    assert send(client, ("tree.ksplat", ksplat_bytes(post_cloud(), 1))).json()["kind"] == "cloud"


def test_a_job_on_a_packed_mesh_writes_its_file(client, runtime, tmp_path, monkeypatch) -> None:
    """Which other people's readers open: tests/export and tests/formats. Jobs on splats: test_clouds.py."""
    monkeypatch.setattr("dynamictree.export.pictures.draw_contact_sheet", lambda *_, **o: np.zeros((300, 200, 3), "u1"))
    asset = send(client, ("tree.glb", packed_glb())).json()
    assert asset["kind"] == "mesh"
    params = {"formats": ["glb"], "glb_compression": "meshopt", "joints": 32, "num_frames": 4, "loop": False}
    request = {"type": "animate", "asset_id": asset["id"], "params": params | {"shot": {"side_px": 64}}}
    job_id = client.post("/v1/jobs", json=request).json()["id"]
    run(runtime, give_spectrum(runtime, runtime.store.job(job_id), tmp_path))
    assert client.get(f"/v1/jobs/{job_id}").json()["state"] == "succeeded"
    listed = client.get(f"/v1/jobs/{job_id}/artifacts").json()["artifacts"]
    [entry] = [entry for entry in listed if entry["name"] == PRODUCTS["glb"].file_name]
    downloaded = client.get(entry["url"])
    assert downloaded.headers["content-type"] == entry["media_type"] == PRODUCTS["glb"].media_type
    assert downloaded.headers["content-disposition"].endswith(f"''{entry['name']}")
    assert len(downloaded.content) == entry["bytes"]
    assert b"EXT_meshopt_compression" in downloaded.content
