"""`*.spectrum.safetensors`: a sparse voxel spectrum, readable wherever safetensors is. See docs/formats.md."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Json

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.errors import NumericsError
from dynamictree.formats.tensors.container import (
    MAX_FRAMES,
    GridFacts,
    checked_tensor,
    facts_of,
    grid_metadata,
    read_grid,
    read_tensors,
    source_metadata,
    tree_numbers,
    write_tensors,
)
from dynamictree.request_model import Finite
from dynamictree.spectrum import Rest, SparseVoxelSpectrum, Wind
from dynamictree.wind_bands import WindBands

FORMAT = "sparse-voxel-spectrum"
VERSION = "1"


class _WindFacts(BaseModel):
    """Wind without the limits of requests."""

    model_config = ConfigDict(extra="forbid")

    speed_m_s: Finite
    direction_deg: Finite
    gust: Finite


class _Facts(GridFacts):
    fps: Finite
    num_frames: Annotated[int, Field(ge=1, le=MAX_FRAMES)]
    rest: Rest = "unloaded"
    model: Annotated[str, Field(pattern=r"^[^\x00-\x1f]{0,200}$")] = ""
    seed: Annotated[int, Field(ge=-(2**63), le=2**64 - 1)]
    wind: Json[_WindFacts | None] = None
    foliage: Finite | None = None


def write_spectrum(
    spectrum: SparseVoxelSpectrum, stream: ByteWriter, *, dtype: Literal["float16", "float32"] = "float16"
) -> None:
    """Write a spectrum; float16 keeps three digits of each coefficient and halves the file.

    Raises:
        NumericsError: a coefficient is not finite, or too large for float16.
    """
    limit = float(np.finfo(dtype).max)
    parts = np.ascontiguousarray(spectrum.coefficients)[..., None].view(np.float32)  # [V, K, 3, 2]
    largest = float(np.abs(parts).max())
    if not largest <= limit:
        raise NumericsError(
            f"the largest coefficient is {largest:.4g} m; {dtype} holds at most {limit:.4g}; the spectrum has diverged"
        )
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        **grid_metadata(spectrum.grid),
        "fps": repr(float(spectrum.fps)),
        "num_frames": str(spectrum.num_frames),
        "rest": spectrum.rest,
        "model": spectrum.model,
        "seed": str(spectrum.seed),
        "wind": json.dumps(asdict(spectrum.wind) if spectrum.wind else None),
        **({} if spectrum.foliage is None else {"foliage": repr(float(spectrum.foliage))}),
        **source_metadata(spectrum.source),
    }
    if dtype == "float16":  # steps are 2^-24 below 2^-13, where numpy reports each number that it rounds
        parts = np.where(np.abs(parts) < 2.0**-13, np.rint(parts * 2.0**24) / 2.0**24, parts)
    tensors = {"coords": spectrum.grid.coords, "coefficients": parts.astype(dtype)}
    if spectrum.tree is not None:
        tensors["tree"] = spectrum.tree
    if spectrum.bands is not None:
        tensors["band_speeds_m_s"] = np.asarray(spectrum.bands.speeds_m_s, np.float32)
        tensors["band_gains"] = np.asarray(spectrum.bands.gains, np.float32)
    write_tensors(stream, tensors, metadata)


def read_spectrum(stream: ByteReader) -> SparseVoxelSpectrum:
    """Read a spectrum; inverse of `write_spectrum` to the precision of its dtype.

    Raises:
        InputError: the file is no spectrum of a known version, or anything in it is out of range.
    """
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION)
    facts = facts_of(metadata, _Facts)
    grid = read_grid(tensors, facts)
    parts = checked_tensor(tensors, "coefficients", dtypes=("float16", "float32"), shape=(len(grid), None, 3, 2))
    coefficients = np.ascontiguousarray(parts, np.float32).view(np.complex64)[..., 0]  # [V, K, 3]
    return SparseVoxelSpectrum(
        grid=grid,
        coefficients=coefficients,
        tree=tree_numbers(tensors, len(grid)),
        fps=facts.fps,
        num_frames=facts.num_frames,
        rest=facts.rest,
        model=facts.model,
        seed=facts.seed,
        wind=None if facts.wind is None else Wind(**facts.wind.model_dump()),
        foliage=facts.foliage,
        bands=_bands(tensors, coefficients.shape[1]),
        source=facts.source,
    )


def _bands(tensors: Mapping[str, np.ndarray], num_frequencies: int) -> WindBands | None:
    if "band_speeds_m_s" not in tensors:
        return None
    speeds = checked_tensor(tensors, "band_speeds_m_s", dtypes=("float32",), shape=(None,))
    gains = checked_tensor(tensors, "band_gains", dtypes=("float32",), shape=(len(speeds), num_frequencies))
    return WindBands(speeds_m_s=tuple(speeds.tolist()), gains=tuple(map(tuple, gains.tolist())))
