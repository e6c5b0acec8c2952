"""A grown tree that the service knows, and how it is pushed: fixtures of the tests of interaction."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from dynamictree.formats.tensors.bundle import write_bundle
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.capture import Capture
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from jobs.lifecycle.attempts import succeed
from jobs.settings import Settings
from jobs.states import stages_of
from jobs.storage.assets import add_asset
from lab.dataset.sample import make_sample, voxel_spectrum
from service.app import create_app
from service.services import Services
from tests.formats.meshes import written
from tests.rows import asset_row, job_row, stored_part
from tests.service.conftest import hold, publish

ASSET_ID = "01ARZ3NDEKTSV4RRFFQ69G5FAV"


@cache  # for all modules
def _grown_with_spectrum():
    sample = make_sample(4, "columnar", wind=Wind(speed_m_s=5.5, direction_deg=40.0))
    return sample, voxel_spectrum(sample, 32)[1]


@pytest.fixture(scope="module")
def grown():
    return _grown_with_spectrum()[0]


@pytest.fixture(scope="module")
def spectrum() -> SparseVoxelSpectrum:
    return _grown_with_spectrum()[1]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """One service for the tests of a module, which leave its asset and its spectrum as they are."""
    settings = Settings(state_dir=tmp_path_factory.mktemp("served"), hosts=("testserver",))
    with TestClient(create_app(settings), "http://localhost", raise_server_exceptions=False) as opened:
        yield opened


@pytest.fixture(scope="module")
def spectrum_id(client: TestClient, grown, spectrum: SparseVoxelSpectrum, tmp_path_factory) -> str:
    return served_id(client, grown.mesh, spectrum, tmp_path_factory.mktemp("tree"))


def served_id(
    client: TestClient,
    mesh: TriangleMesh,
    spectrum: SparseVoxelSpectrum,
    folder: Path,
    asset_id: str = ASSET_ID,
    sent: Capture | None = None,
    **params: object,
) -> str:
    """The id of a spectrum that a job of the service has had as its result, of a mesh or of a cloud that was sent."""
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    bundle, now = folder / "mesh.safetensors", services.store.clock()
    bundle.write_bytes(written(write_bundle, sent or mesh))
    part, kind = stored_part(services.artifacts, bundle), "cloud" if sent else "mesh"
    row = asset_row(part, now=now, id=asset_id, fingerprint=asset_id, expires_at=now + 5000, kind=kind)
    job = job_row(add_asset(services.store, row)[0], now=now, params=params)
    services.store.add_job(job, stages=stages_of("diffuse", row.kind))
    lease = hold(services, job.id)
    if sent:
        publish(services, lease, "reconstruct", "mesh.safetensors", written(write_bundle, mesh))
    publish(services, lease, "voxelize", "tree.voxels.safetensors", b"voxels")
    file = written(write_spectrum, spectrum, dtype="float32")
    publish(services, lease, "diffuse", "tree.spectrum.safetensors", file)
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
