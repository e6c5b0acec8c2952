"""/v1/spectra: properties of a spectrum; its bytes are an artifact."""

from fastapi import APIRouter
from pydantic import Field

from dynamictree.requests import Wind
from service.http.routing import Id, refusals
from service.schemas.base import Payload
from service.services import OwnedDep
from service.stored_trees import load_spectrum

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
    wind: Wind | None
    units: str = "m"
    up_axis: str = "+Z"
    artifact_url: str


@router.get("/{id}", operation_id="getSpectrum", responses=refusals("not-found", "expired"))
def get_spectrum(id: Id, owned: OwnedDep) -> SpectrumPayload:
    """What a spectrum is: frequencies, voxels, bounds, model. The coefficients are the artefact's bytes."""
    spectrum = load_spectrum(owned, id)
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
        wind=spectrum.wind,
        artifact_url=f"/v1/artifacts/{id}",
    )
