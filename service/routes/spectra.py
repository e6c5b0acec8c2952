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
    """How much stronger each mode is in other winds. Between two speeds the gain is linear in the drag.

    The drag is speed^1.4 up to 12 m/s, and in proportion to the speed above.
    """

    speeds_m_s: list[float] = Field(description="[B] rising from 0; above the last the gains stay")
    gains: list[list[float]] = Field(description="[B][K] over the size in the spectrum's own wind; bin 0 is the lean")


class SpectrumPayload(Payload):
    """A sparse voxel spectrum without its coefficients. Lengths in metres, +Z up."""

    id: str
    num_frequencies: int = Field(description="K")
    frequencies_hz: Row
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
    foliage: float | None = Field(description="0 bare, 1 in leaf; null where the shape did not tell")
    wind_bands: WindBandsPayload | None = Field(description="null unless the job asked for them")
    units: str = "m"
    up_axis: str = "+Z"
    artifact_url: str


@router.get("/{id}", responses=refusals("not-found", "expired"))
def get_spectrum(id: Id, owned: OwnedDep) -> SpectrumPayload:
    """What a spectrum is: frequencies, voxels, bounds, model. The coefficients are the artefact's bytes."""
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
    """Coordinates of the bins in wind that never repeats, as sums of cosines. docs/engines.md evaluates them."""

    spectrum_id: str
    seed: int
    wind: Wind = Field(description="mean speed, direction and gust")
    natural_frequency_hz: float = Field(description="lowest, of a tree of this height")
    damping_ratio: float = Field(description="of a tree with this foliage")
    length_scale_m: float = Field(description="of the turbulence at the top of the tree")
    frequencies_hz: Row = Field(description="of the K bins; bin 0 is the lean")
    bandwidth_hz: Row = Field(description="half-width of each bin's line at half of its power")
    partial_hz: list[list[float]] = Field(description="[K - 1][J] from bin 1")
    partial_phase_rad: list[list[float]] = Field(description="[K - 1][J] from bin 1")
    strength: WavePayload = Field(description="factor on the coordinates of bins 1 to K - 1")
    lean: WavePayload = Field(description="coordinate of bin 0, which is real")
    bands: WindBandsPayload = Field(
        description="factors on the coordinates by mean speed: by the model where the job asked for wind_bands, else a "
        "power law"
    )
    turn_rad: WavePayload = Field(description="of the whole displacement about the vertical, from +X towards +Y")


@router.get("/{id}/wind", responses=refusals("not-found", "expired"))
def get_wind(
    id: Id,
    owned: OwnedDep,
    seed: Annotated[int, Query(ge=0, le=MAX_SEED, description="the same seed gives the same wind")] = 0,
    gust: Annotated[
        float | None,
        Query(ge=0, le=2, allow_inf_nan=False, description="standard deviation of the speed over its mean"),
    ] = None,
    speed_m_s: Annotated[
        float | None,
        Query(ge=0, le=30, allow_inf_nan=False, description="mean speed; the spectrum's own if unset [m/s]"),
    ] = None,
) -> TurbulentWindPayload:
    """Wind that never repeats, as a table of cosines: with the mode shapes it gives every voxel at any time."""
    spectrum = load_spectrum(owned, id)
    chosen = {name: value for name, value in (("gust", gust), ("speed_m_s", speed_m_s)) if value is not None}
    turbulent = turbulent_wind(spectrum, seed=seed, wind=replace(spectrum.wind or Wind(), **chosen))
    return TurbulentWindPayload.of(
        turbulent,
        spectrum_id=id,
        partial_hz=turbulent.partial_hz[1:].tolist(),
        partial_phase_rad=turbulent.partial_phase_rad[1:].tolist(),
    )
