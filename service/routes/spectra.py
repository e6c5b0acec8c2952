"""/v1/spectra: properties of a spectrum and of its wind; its bytes are an artifact."""

from dataclasses import replace
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query
from pydantic import BeforeValidator, Field

from dynamictree.modal.turbulence import turbulent_wind
from dynamictree.requests import MAX_SEED, Wind
from service.http.routing import Id, refusals
from service.interact.stored_trees import load_spectrum
from service.schemas.base import Payload
from service.services import OwnedDep

router = APIRouter(prefix="/v1/spectra", tags=["spectra"])

Row = Annotated[list[float], BeforeValidator(lambda row: np.asarray(row).tolist())]


class WindBandsPayload(Payload):
    """Gain of each mode by wind speed. Between two speeds, the gain is linear in the drag.

    The drag is speed^1.4 up to 12 m/s, and proportional to the speed above.
    """

    speeds_m_s: list[float] = Field(description="Mean speeds [B], from 0 upward; gains are constant above the last")
    gains: list[list[float]] = Field(description="Gains [B][K] relative to the spectrum's own wind; bin 0 is the lean")


class SpectrumPayload(Payload):
    """A sparse voxel spectrum without its coefficients. Lengths in metres, +Z up."""

    id: str
    num_frequencies: int = Field(description="Number K of frequency bins")
    frequencies_hz: Row
    num_voxels: int = Field(description="Number V of occupied voxels")
    resolution: int
    voxel_size_m: float
    origin_m: list[float] = Field(description="Low corner of the grid's cube [m]")
    low_m: list[float] = Field(description="Low corner of the occupied voxels [m]")
    high_m: list[float] = Field(description="High corner of the occupied voxels [m]")
    fps: float
    num_frames: int
    period_s: float
    rest: str
    model: str
    seed: int
    wind: Wind | None
    foliage: float | None = Field(description="Foliage, 0 (bare) to 1 (in leaf); null if unknown")
    wind_bands: WindBandsPayload | None = Field(description="Null unless the job requested them")
    units: str = "m"
    up_axis: str = "+Z"
    artifact_url: str


@router.get("/{id}", responses=refusals("not-found", "expired"))
def get_spectrum(id: Id, owned: OwnedDep) -> SpectrumPayload:
    """Return properties of a spectrum: frequencies, voxels, bounds, model. Its coefficients are in the artifact."""
    spectrum = load_spectrum(owned, id)
    grid = spectrum.grid
    low, high = grid.coords.min(axis=0), grid.coords.max(axis=0) + 1
    return SpectrumPayload.of(
        spectrum,
        id=id,
        num_voxels=len(grid),
        resolution=grid.resolution,
        voxel_size_m=grid.voxel_size_m,
        origin_m=list(grid.origin_m),
        low_m=[float(o + c * grid.voxel_size_m) for o, c in zip(grid.origin_m, low, strict=True)],
        high_m=[float(o + c * grid.voxel_size_m) for o, c in zip(grid.origin_m, high, strict=True)],
        wind_bands=spectrum.bands,
        artifact_url=f"/v1/artifacts/{id}",
    )


class WavePayload(Payload):
    """mean + limit · tanh(Σ_m amplitude_m cos(2π frequency_hz_m t + phase_rad_m) / limit)."""

    mean: float
    limit: float
    frequency_hz: Row
    amplitude: Row
    phase_rad: Row


class TurbulentWindPayload(Payload):
    """Coordinates of the bins in wind that never repeats, as sums of cosines. See docs/engines.md."""

    spectrum_id: str
    seed: int
    wind: Wind = Field(description="Mean speed, direction and gust")
    natural_frequency_hz: float = Field(description="Lowest frequency of a tree of this height [Hz]")
    damping_ratio: float = Field(description="Damping ratio of a tree with this foliage")
    length_scale_m: float = Field(description="Turbulence length scale at the top of the tree [m]")
    frequencies_hz: Row = Field(description="Frequencies of the K bins [Hz]; bin 0 is the lean")
    bandwidth_hz: Row = Field(description="Half width at half maximum of each bin's line [Hz]")
    partial_hz: list[list[float]] = Field(description="Frequencies of partials [K - 1][J], from bin 1 [Hz]")
    partial_phase_rad: list[list[float]] = Field(description="Phases of partials [K - 1][J], from bin 1 [rad]")
    strength: WavePayload = Field(description="Factor on the coordinates of bins 1 to K - 1")
    lean: WavePayload = Field(description="Coordinate of bin 0, which is real")
    bands: WindBandsPayload = Field(
        description="Factors on the coordinates by mean speed: from the model if the job requested wind_bands, else a "
        "power law"
    )
    turn_rad: WavePayload = Field(description="Rotation of all displacements about +Z, from +X towards +Y")


@router.get("/{id}/wind", responses=refusals("not-found", "expired"))
def get_wind(
    id: Id,
    owned: OwnedDep,
    seed: Annotated[int, Query(ge=0, le=MAX_SEED, description="Random seed of the wind")] = 0,
    gust: Annotated[
        float | None,
        Query(ge=0, le=2, allow_inf_nan=False, description="Standard deviation of the speed, relative to its mean"),
    ] = None,
    speed_m_s: Annotated[
        float | None,
        Query(ge=0, le=30, allow_inf_nan=False, description="Mean speed [m/s]; by default the spectrum's own"),
    ] = None,
) -> TurbulentWindPayload:
    """Return wind that never repeats, as sums of cosines; with mode shapes, they move every voxel at any time."""
    spectrum = load_spectrum(owned, id)
    chosen = {name: value for name, value in (("gust", gust), ("speed_m_s", speed_m_s)) if value is not None}
    turbulent = turbulent_wind(spectrum, seed=seed, wind=replace(spectrum.wind or Wind(), **chosen))
    return TurbulentWindPayload.of(
        turbulent,
        spectrum_id=id,
        partial_hz=turbulent.partial_hz[1:].tolist(),
        partial_phase_rad=turbulent.partial_phase_rad[1:].tolist(),
    )
