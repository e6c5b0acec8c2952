"""/v1/spectra: what a spectrum is; its bytes are an artefact. Loads one, and its tree, for those that compute."""

from io import BytesIO
from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import Field, TypeAdapter

from dynamictree.formats.spectrum_file import read_spectrum
from dynamictree.gaussian.capture import Box, Capture
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import SparseVoxelSpectrum
from jobs.errors import GoneError, NotFoundError
from jobs.products import MESH_BUNDLE, SPECTRUM
from jobs.records import ArtifactRecord
from service.context import Context, Ctx
from service.payloads import Payload, WindPayload
from service.problems import ProblemError
from service.routing import Id, refusals

router = APIRouter(prefix="/v1/spectra", tags=["spectra"])


class SpectrumPayload(Payload):
    """A sparse voxel spectrum without its coefficients. Lengths in metres, +Z up."""

    id: str
    num_frequencies: int = Field(description="K")
    frequencies_hz: list[float]
    num_voxels: int = Field(description="V")
    resolution: int
    voxel_size_m: float
    origin_m: list[float] = Field(description="low corner of the grid's cube [m]")
    low_m: list[float] = Field(description="low corner of the occupied voxels [m]")
    high_m: list[float] = Field(description="high corner of the occupied voxels [m]")
    fps: float
    num_frames: int
    period_s: float
    rest: str
    model: str
    seed: int
    wind: WindPayload | None
    units: str = "m"
    up_axis: str = "+Z"
    artifact_url: str


def spectrum_artifact(context: Context, spectrum_id: str) -> ArtifactRecord:
    """The artefact that a spectrum is.

    Raises:
        NotFoundError, GoneError: there is none, it is of another kind, or it has expired.
    """
    artifact = context.store.artifact(spectrum_id)
    if artifact.name != SPECTRUM:
        raise NotFoundError(f"artefact {spectrum_id} is no spectrum but {artifact.name}")
    return artifact


def load_spectrum(context: Context, spectrum_id: str) -> SparseVoxelSpectrum:
    """A spectrum with its coefficients, from memory where it was used lately.

    Raises:
        NotFoundError, GoneError: there is none, it is of another kind, or it has expired.
    """
    artifact = spectrum_artifact(context, spectrum_id)
    kept = context.spectra.get(artifact.sha256)
    if kept is not None:
        return kept
    try:
        content = b"".join(context.artifacts.read(artifact.sha256))
    except FileNotFoundError as error:
        raise GoneError(f"the bytes of spectrum {spectrum_id} were removed; run the job again") from error
    spectrum = read_spectrum(BytesIO(content))
    context.spectra.put(artifact.sha256, spectrum)
    return spectrum


def load_source_mesh(context: Context, spectrum_id: str) -> TriangleMesh:
    """The mesh that a spectrum was made for.

    Raises:
        NotFoundError, GoneError: there is no such spectrum, or its asset has expired.
    """
    from dynamictree.formats.mesh_bundle import read_mesh_bundle

    artifact = spectrum_artifact(context, spectrum_id)
    asset = context.store.asset(context.store.job(artifact.job_id).asset_id)
    made = [other for other in context.store.artifacts_of(artifact.job_id) if other.name == MESH_BUNDLE]
    if asset.prepared is not None and asset.kind == "mesh":
        digest = asset.prepared.sha256
    elif made:
        digest = made[0].sha256
    else:
        raise GoneError(f"the mesh of spectrum {spectrum_id} was removed; run the job again")
    try:
        return read_mesh_bundle(BytesIO(b"".join(context.artifacts.read(digest))))
    except FileNotFoundError as error:
        raise GoneError(f"the mesh of spectrum {spectrum_id} was removed; upload it again") from error


def load_source_cloud(context: Context, spectrum_id: str) -> tuple[Capture, Box | None]:
    """The cloud that a spectrum was made for, and the box of its job: only what is inside moves.

    Raises:
        NotFoundError, GoneError: there is no such spectrum, or its asset has expired.
        ProblemError: the source is no cloud.
    """
    from dynamictree.formats.cloud_bundle import read_cloud_bundle

    job = context.store.job(spectrum_artifact(context, spectrum_id).job_id)
    asset = context.store.asset(job.asset_id)
    if asset.kind != "cloud" or asset.prepared is None:
        found = f"this spectrum's source is of kind {asset.kind}; output gaussians needs a cloud"
        raise ProblemError("invalid-input", f"{found}. Ask for vertices, voxels or modal")
    try:
        capture = read_cloud_bundle(BytesIO(b"".join(context.artifacts.read(asset.prepared.sha256))))
    except FileNotFoundError as error:
        raise GoneError(f"the cloud of spectrum {spectrum_id} was removed; upload it again") from error
    low_high = TypeAdapter(Box | None).validate_python(job.params.get("box_m"))
    return capture, low_high


@router.get("/{id}", operation_id="getSpectrum", responses=refusals("not-found", "expired"))
def get_spectrum(id: Id, context: Ctx) -> SpectrumPayload:
    """What a spectrum is: frequencies, voxels, bounds, model. The coefficients are the artefact's bytes."""
    spectrum = load_spectrum(context, id)
    grid = spectrum.grid
    low, high = grid.coords.min(axis=0), grid.coords.max(axis=0) + 1
    return SpectrumPayload(
        id=id,
        num_frequencies=spectrum.num_frequencies,
        frequencies_hz=[float(value) for value in spectrum.frequencies_hz],
        num_voxels=len(grid),
        resolution=grid.resolution,
        voxel_size_m=grid.voxel_size_m,
        origin_m=list(grid.origin_m),
        low_m=[float(o + c * grid.voxel_size_m) for o, c in zip(grid.origin_m, low, strict=True)],
        high_m=[float(o + c * grid.voxel_size_m) for o, c in zip(grid.origin_m, high, strict=True)],
        fps=spectrum.fps,
        num_frames=spectrum.num_frames,
        period_s=spectrum.period_s,
        rest=spectrum.rest,
        model=spectrum.model,
        seed=spectrum.seed,
        wind=None
        if spectrum.wind is None
        else WindPayload(
            speed_m_s=spectrum.wind.speed_m_s, direction_deg=spectrum.wind.direction_deg, gust=spectrum.wind.gust
        ),
        artifact_url=f"/v1/artifacts/{id}",
    )


def _spectrum_of_path(id: Id, context: Ctx) -> SparseVoxelSpectrum:
    return load_spectrum(context, id)


SpectrumOfPath = Annotated[SparseVoxelSpectrum, Depends(_spectrum_of_path)]
"""For routes whose path names a spectrum."""
