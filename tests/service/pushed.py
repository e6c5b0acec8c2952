"""A grown tree that the service knows, and how it is pushed: fixtures of the tests of interaction."""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from dynamictree.formats.tensors.bundle import write_bundle
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from jobs.lifecycle.attempts import succeed
from jobs.settings import Settings
from jobs.storage.assets import add_asset
from lab.dataset.sample import make_sample, voxel_spectrum
from service.app import create_app
from service.services import Services
from tests.rows import asset_row, job_row, stored_part
from tests.service.conftest import hold, publish

ASSET_ID = "01ARZ3NDEKTSV4RRFFQ69G5FAV"


@pytest.fixture(scope="module")
def grown():
    return make_sample(4, "columnar", wind=Wind(speed_m_s=5.5, direction_deg=40.0))


@pytest.fixture(scope="module")
def spectrum(grown) -> SparseVoxelSpectrum:
    return voxel_spectrum(grown, 32)[1]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """One service for the tests of a module, which leave its asset and its spectrum as they are."""
    settings = Settings(state_dir=tmp_path_factory.mktemp("served"), hosts=("testserver",))
    with TestClient(create_app(settings), "http://localhost", raise_server_exceptions=False) as opened:
        yield opened


@pytest.fixture(scope="module")
def spectrum_id(client: TestClient, grown, spectrum: SparseVoxelSpectrum, tmp_path_factory) -> str:
    return served_id(client, grown.mesh, spectrum, tmp_path_factory.mktemp("tree"))


def served_id(client: TestClient, mesh, spectrum: SparseVoxelSpectrum, folder: Path, asset_id: str = ASSET_ID) -> str:
    """The id of a spectrum that a job of the service has had as its result."""
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    bundle = folder / "mesh.safetensors"
    with bundle.open("wb") as stream:
        write_bundle(mesh, stream)
    part = stored_part(services.artifacts, bundle)
    now = services.store.clock()
    row = asset_row(part, now=now, id=asset_id, fingerprint=asset_id, expires_at=now + 5000)
    job = job_row(add_asset(services.store, row)[0], now=now)
    services.store.add_job(job, stages=("voxelize", "diffuse"))
    lease = hold(services, job.id)
    publish(services, lease, "voxelize", "tree.voxels.safetensors", b"voxels")
    file = io.BytesIO()
    write_spectrum(spectrum, file, dtype="float32")
    publish(services, lease, "diffuse", "tree.spectrum.safetensors", file.getvalue())
    succeed(services.store, lease)
    return str(client.get(f"/v1/jobs/{job.id}").json()["result"]["spectrum_id"])


@pytest.fixture(scope="module")
def poke(spectrum: SparseVoxelSpectrum) -> dict[str, object]:
    top = int(np.argmax(spectrum.grid.coords[:, 2]))
    return {"kind": "impulse", "at": {"voxel": top}, "impulse_n_s": [3.0, 1.0, 0.0]}


def post(client: TestClient, spectrum_id: str, *forces: object, accept: str | None = None, **options: object):
    headers = {} if accept is None else {"Accept": accept}
    body = {"spectrum_id": spectrum_id, "forces": list(forces), **options}
    return client.post("/v1/interact", json=body, headers=headers)
