"""Shared parts of the project's safetensors files: format, version and grid in the metadata."""

import json
import math
from collections.abc import Mapping
from typing import Annotated, TypeVar

import numpy as np
from jaxtyping import Int32, Shaped
from pydantic import BaseModel, Field, Json, ValidationError
from safetensors import SafetensorError, deserialize

from dynamictree.axis_names import UP_AXIS_PATTERN
from dynamictree.byte_stream import ByteReader, ByteWriter, read_all
from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader
from dynamictree.request_model import Finite
from dynamictree.source import Source
from dynamictree.voxel.grid import VoxelGrid

MAX_FILE_BYTES = 1 << 30
MAX_FRAMES = 1_000_000
MAX_RESOLUTION = 4096  # keys of its voxels are far below the limit of int64

_DTYPES = {"F16": np.float16, "F32": np.float32, "I32": np.int32, "I16": np.int16, "U8": np.uint8}
_NAMES = {np.dtype(dtype).name: name for name, dtype in _DTYPES.items()}


def read_tensors(
    stream: ByteReader, *, file_format: str, version: str, max_bytes: int = MAX_FILE_BYTES
) -> tuple[dict[str, Shaped[np.ndarray, "..."]], dict[str, str]]:
    """Read tensors and metadata of a file that states this format and version.

    Raises:
        FormatError: not safetensors, too large, another format, an unknown version, an unsupported dtype.
    """
    content = read_all(stream, max_bytes)
    try:
        described = deserialize(content)  # type: ignore[no-untyped-call]
    except SafetensorError as error:
        raise FormatError(
            f"the file is no {file_format}: safetensors finds {error}; give one as docs/formats.md describes it"
        ) from error
    # deserialize has checked that the header is there, is JSON and fits the bytes
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    metadata: dict[str, str] = header.get("__metadata__") or {}
    for name, expected in (("format", file_format), ("version", version)):
        if metadata.get(name) != expected:
            actual = str(metadata.get(name))[:80]
            raise FormatError(f"the file's {name} is {actual!r}; this reader knows {expected!r}")
    tensors = {}
    for name, entry in described:
        if entry["dtype"] not in _DTYPES:
            raise FormatError(f"tensor {name[:80]!r} is of {entry['dtype']}; {', '.join(_DTYPES)} are allowed")
        tensors[name] = np.frombuffer(entry["data"], _DTYPES[entry["dtype"]]).reshape(entry["shape"])
    return tensors, metadata


def tensor_format(stream: SeekableReader) -> str | None:
    """Return the format that a file's metadata state; None if it is no safetensors. The stream is left at its start."""
    max_header_bytes = 1 << 20
    stream.seek(0)
    length = int.from_bytes(stream.read(8), "little")
    header = stream.read(min(length, max_header_bytes))
    stream.seek(0)
    try:
        metadata = json.loads(header)["__metadata__"]
        return str(metadata["format"])
    except (ValueError, KeyError, TypeError):
        return None


def write_tensors(
    stream: ByteWriter, tensors: Mapping[str, Shaped[np.ndarray, "..."]], metadata: Mapping[str, str]
) -> None:
    """Write tensors; equal values give equal bytes, whereas safetensors' own writer shuffles the metadata."""
    ordered = sorted(tensors.items(), key=lambda item: (-item[1].itemsize, item[0]))  # this order aligns all
    stream.write(file_head({name: (tensor.dtype.name, tensor.shape) for name, tensor in ordered}, metadata))
    for _, tensor in ordered:
        stream.write(np.ascontiguousarray(tensor).tobytes())


def file_head(tensors: Mapping[str, tuple[str, tuple[int, ...]]], metadata: Mapping[str, str]) -> bytes:
    """Return the bytes before the tensors' own, which follow in the given order."""
    header: dict[str, object] = {"__metadata__": dict(metadata)}
    start = 0
    for name, (dtype, shape) in tensors.items():
        end = start + np.dtype(dtype).itemsize * math.prod(shape)
        header[name] = {"dtype": _NAMES[dtype], "shape": list(shape), "data_offsets": [start, end]}
        start = end
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def checked_tensor(
    tensors: Mapping[str, Shaped[np.ndarray, "..."]],
    name: str,
    *,
    dtypes: tuple[str, ...],
    shape: tuple[int | None, ...],
) -> Shaped[np.ndarray, "..."]:
    """Return one tensor of a file after checks; None in `shape` allows any length.

    Raises:
        FormatError: it is missing, of another dtype or shape, or has values that are not finite.
    """
    if name not in tensors:
        raise FormatError(f"the file has no tensor {name!r}; it has {sorted(tensors)[:8]}")
    tensor = tensors[name]
    fits = len(shape) == tensor.ndim and all(
        want in (None, actual) for want, actual in zip(shape, tensor.shape, strict=True)
    )
    if tensor.dtype.name not in dtypes or not fits:
        allowed = f"{' or '.join(dtypes)} {['any' if n is None else n for n in shape]}"
        raise FormatError(f"tensor {name!r} is {tensor.dtype.name} {list(tensor.shape)}; {allowed} is allowed")
    if tensor.dtype.kind == "f" and not np.isfinite(tensor).all():
        raise FormatError(f"tensor {name!r} holds {int((~np.isfinite(tensor)).sum())} values that are not finite")
    return tensor


def grid_metadata(grid: VoxelGrid) -> dict[str, str]:
    """Return the grid's frame as strings; `read_grid` is the inverse."""
    return {
        "resolution": str(grid.resolution),
        "origin_m": json.dumps(grid.origin_m),
        "voxel_size_m": repr(float(grid.voxel_size_m)),
    }


def read_grid(tensors: Mapping[str, Shaped[np.ndarray, "..."]], facts: "GridFacts") -> VoxelGrid:
    """Return the grid of a file.

    Raises:
        InputError: there are no voxels, or they are outside of the cube, not unique or not in order.
    """
    coords = checked_tensor(tensors, "coords", dtypes=("int32",), shape=(None, 3))
    return VoxelGrid(
        coords=coords, origin_m=facts.origin_m, voxel_size_m=facts.voxel_size_m, resolution=facts.resolution
    )


def tree_numbers(tensors: Mapping[str, Shaped[np.ndarray, "..."]], num_voxels: int) -> Int32[np.ndarray, " V"] | None:
    """Return the index of each voxel's tree; None if the file has none.

    Raises:
        FormatError: a number is out of range.
    """
    if "tree" not in tensors:
        return None
    tree = checked_tensor(tensors, "tree", dtypes=("int32",), shape=(num_voxels,))
    if tree.min() < 0 or tree.max() >= num_voxels:
        raise FormatError(f"trees are numbered from {tree.min()} to {tree.max()}; 0 to {num_voxels - 1} are allowed")
    return tree


def source_metadata(source: Source) -> dict[str, str]:
    """Return the source of a shape as strings; `SourceFacts` is the inverse."""
    if not source.up_axis:
        return {"source_sha256": source.sha256}
    return {
        "source_sha256": source.sha256,
        "source_up_axis": source.up_axis,
        "source_up_confidence": json.dumps(source.up_confidence),
        "source_scale": json.dumps(source.scale),
        "source_offset": json.dumps(source.offset),
    }


Facts = TypeVar("Facts", bound=BaseModel)


def facts_of(metadata: Mapping[str, str], model: type[Facts]) -> Facts:
    """Validate the fields of a file's metadata, which are strings, some of them JSON; unknown ones are ignored.

    Raises:
        FormatError: a field is missing or invalid.
    """
    max_field_chars = 4096  # a hostile field must not exhaust the JSON parser
    for name in model.model_fields:
        if (length := len(metadata.get(name, ""))) > max_field_chars:
            raise FormatError(f"metadata {name!r} has {length} characters; at most {max_field_chars} are allowed")
    try:
        return model.model_validate(metadata)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = ".".join(map(str, first["loc"]))
        raise FormatError(f"metadata {name!r} is {str(first['input'])[:80]!r}: {first['msg']}") from None


class SourceFacts(BaseModel):
    """Source of the shape in a file."""

    source_sha256: Annotated[str, Field(pattern="^([0-9a-f]{64})?$")] = ""
    source_up_axis: Annotated[str, Field(pattern=f"^({UP_AXIS_PATTERN})?$")] = ""
    source_up_confidence: Json[Finite | None] = None
    source_scale: Json[Finite | None] = None
    source_offset: Json[tuple[Finite, Finite, Finite]] = (0.0, 0.0, 0.0)  # absent from older files

    @property
    def source(self) -> Source:
        """The source as a value."""
        return Source(
            sha256=self.source_sha256,
            up_axis=self.source_up_axis,
            up_confidence=1.0 if self.source_up_confidence is None else self.source_up_confidence,
            scale=1.0 if self.source_scale is None else self.source_scale,
            offset=self.source_offset,
        )


class GridFacts(SourceFacts):
    """Source and frame of a grid; inverse of `grid_metadata`."""

    resolution: Annotated[int, Field(ge=1, le=MAX_RESOLUTION)]
    origin_m: Json[tuple[Finite, Finite, Finite]]
    voxel_size_m: Finite
