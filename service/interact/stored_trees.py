"""Load spectra, and the meshes and clouds that they were made for, from storage.

All functions raise NotFoundError or GoneError if no spectrum or asset has this id, or it has expired.
"""

import time
from io import BytesIO
from threading import BoundedSemaphore
from typing import Literal

from dynamictree.formats.tensors.spectrum import read_spectrum
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.capture import Capture, with_one_moving_tree
from dynamictree.plant.choice import with_choice
from dynamictree.plant.trees.of_mesh import only_tree_of
from dynamictree.requests import CloudParams
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.errors import ConflictError, GoneError, NotFoundError
from jobs.records import ArtifactRecord, AssetRecord, JobRecord
from jobs.storage.assets import read_asset
from jobs.storage.intermediates import RESULT_SOURCES, find_stored, result_key
from jobs.storage.stage_files import MESH_BUNDLE, SPECTRUM
from service.http.problems import ProblemError
from service.http.routing import is_id
from service.services import Owned

_AWAITING = BoundedSemaphore(16)  # each waiting request occupies one of the process's 40 threads; a page sends two


def spectrum_artifact(owned: Owned, spectrum_id: str) -> ArtifactRecord:
    """Return the artifact record of a spectrum."""
    if not is_id(spectrum_id):
        raise NotFoundError(f"there is no spectrum {spectrum_id!r}; a job's result names the one that it made")
    artifact = owned.store.artifact(spectrum_id)
    if artifact.name != SPECTRUM:
        raise NotFoundError(f"artefact {spectrum_id} is no spectrum but {artifact.name}")
    return artifact


def source_of(owned: Owned, spectrum_id: str) -> tuple[JobRecord, AssetRecord]:
    """Return the job that made a spectrum, and the job's asset."""
    job = owned.store.job(spectrum_artifact(owned, spectrum_id).job_id)
    return job, read_asset(owned.store, job.asset_id)


def load_spectrum(owned: Owned, spectrum_id: str) -> SparseVoxelSpectrum:
    """Load a spectrum with its coefficients; recently used ones are cached."""
    artifact = spectrum_artifact(owned, spectrum_id)
    spectrum = owned.services.spectra.get(artifact.sha256)
    if spectrum is None:
        spectrum = read_spectrum(_stored(owned, artifact.sha256, f"spectrum {spectrum_id}"))
        owned.services.spectra.put(artifact.sha256, spectrum)
    return spectrum


def load_source_mesh(owned: Owned, spectrum_id: str) -> TriangleMesh:
    """Load the mesh that a spectrum was made for."""
    job, asset = source_of(owned, spectrum_id)
    if asset.prepared is not None and asset.kind == "mesh":
        params = CloudParams.part_of(job.params)
        mesh = with_choice(_mesh(owned, asset.prepared.sha256, asset.id), params)
        return mesh if params.tree is None else only_tree_of(mesh, params.tree)
    bundles = [other for other in owned.store.artifacts_of(job.id) if other.name == MESH_BUNDLE]
    if not bundles:
        raise GoneError(f"the mesh of spectrum {spectrum_id} was removed; run the job again")
    return _mesh(owned, bundles[0].sha256, f"of spectrum {spectrum_id}")


def load_result(owned: Owned, spectrum_id: str, name: str) -> BytesIO | None:
    """Load an intermediate result of the spectrum's job; wait if a worker is computing it. None if there is none."""
    job, asset = source_of(owned, spectrum_id)
    digests = {other.name: other.sha256 for other in owned.store.artifacts_of(job.id)}
    if asset.prepared is not None and asset.kind == "mesh":
        digests[MESH_BUNDLE] = asset.prepared.sha256
    if not digests.keys() >= set(RESULT_SOURCES[name]):
        return None
    choice = CloudParams.part_of(job.params).model_dump(mode="json")
    key = result_key(name, job, [digests[source] for source in RESULT_SOURCES[name]], choice)
    wanted = (owned.store, owned.services.artifacts, key)
    waits = _AWAITING.acquire(blocking=False)
    try:
        while not (files := find_stored(*wanted)) and owned.store.job(job.id).state == "running":
            if not waits:
                raise ProblemError("overloaded", f"too many requests wait for what jobs compute now, as the {name}")
            time.sleep(0.1)  # a worker is computing it; computing it here too would take longer
    finally:
        if waits:
            _AWAITING.release()
    files = files or find_stored(*wanted)  # the job may have ended in between
    return _stored(owned, files[0].sha256, f"{name} of spectrum {spectrum_id}") if files else None


def load_asset_mesh(owned: Owned, asset_id: str) -> TriangleMesh:
    """Load the mesh of an asset."""
    return _mesh(owned, _prepared(owned, asset_id, "mesh", "a job makes its mesh"), asset_id)


def load_asset_cloud(owned: Owned, asset_id: str) -> GaussianCloud:
    """Load the cloud of an asset."""
    from dynamictree.formats.tensors.bundle import read_cloud_bundle

    digest = _prepared(owned, asset_id, "cloud", "only splats and scans have points")
    return read_cloud_bundle(_stored(owned, digest, f"cloud {asset_id}")).cloud


def load_source_cloud(owned: Owned, spectrum_id: str) -> tuple[Capture, CloudParams]:
    """Load the cloud that a spectrum was made for, and the job's choice of moving parts."""
    from dynamictree.formats.tensors.bundle import read_cloud_bundle

    job, asset = source_of(owned, spectrum_id)
    if asset.kind != "cloud" or asset.prepared is None:
        detail = f"this spectrum's source is of kind {asset.kind}; output gaussians needs a cloud"
        raise ProblemError("invalid-input", f"{detail}. Ask for vertices, voxels or modal")
    capture = read_cloud_bundle(_stored(owned, asset.prepared.sha256, f"cloud {asset.id}"))
    params = CloudParams.part_of(job.params)
    return capture if params.tree is None else with_one_moving_tree(capture, params.tree), params


def _prepared(owned: Owned, asset_id: str, kind: Literal["mesh", "cloud"], otherwise: str) -> str:
    """Return the digest of an asset's prepared file; refuse an asset of another kind."""
    asset = read_asset(owned.store, asset_id)
    if asset.kind != kind or asset.prepared is None:
        raise ConflictError(f"asset {asset_id} is no {kind} but {asset.kind}; {otherwise}")
    return asset.prepared.sha256


def _mesh(owned: Owned, digest: str, whose: str) -> TriangleMesh:
    from dynamictree.formats.tensors.bundle import read_mesh_bundle

    return read_mesh_bundle(_stored(owned, digest, f"mesh {whose}"))


def _stored(owned: Owned, digest: str, what: str) -> BytesIO:
    try:
        return BytesIO(b"".join(owned.services.artifacts.read(digest)))
    except FileNotFoundError as error:
        raise GoneError(f"the bytes of {what} were removed; send it or run its job again") from error
