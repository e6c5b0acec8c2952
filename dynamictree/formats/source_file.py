"""Read any input shape: a mesh, or a cloud with an optional mask and mesh."""

from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from typing import Literal

import numpy as np
from jaxtyping import Bool

from dynamictree.errors import FormatError
from dynamictree.formats.cloud_file import CLOUD_TYPES, SPLAT_TYPES, cloud_facts, cloud_kind, read_cloud
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.formats.origin import offset_warnings
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.formats.splat.sog import bundled, is_folder_file
from dynamictree.gaussian.cloud import MAX_GAUSSIANS, GaussianCloud
from dynamictree.mesh import SourceWarning
from dynamictree.plant.capture import Capture
from dynamictree.plant.find import plant_of_cloud
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation

SourceKind = Literal["mesh", "cloud"]


def source_kind(stream: SeekableReader, name: str) -> tuple[SourceKind, str]:
    """Return whether a file is a mesh or a cloud, and its type for the readers; the stream is left at its start.

    Raises:
        FormatError: it is neither, or a header breaks its format's rules.
    """
    head_bytes = 64 * 1024
    ending = name.rpartition(".")[2].lower()
    if ending in SPLAT_TYPES:
        return "cloud", ending
    stream.seek(0)
    head = stream.read(head_bytes)
    stream.seek(0)
    if head.lstrip().startswith(b"{") and all(word in head for word in (b'"means"', b'"quats"', b'"scales"')):
        return "cloud", "sog"
    file_type = sniff_file_type(head, name)
    if file_type in ("points", "las", "pcd"):
        return "cloud", "txt" if file_type == "points" else file_type
    if file_type in ("ply", "glb") and cloud_kind(stream, file_type=file_type) != "mesh":
        return "cloud", file_type
    return "mesh", file_type


def read_capture(
    stream: SeekableReader,
    *,
    file_type: str,
    reading: Reading | None = None,
    mask: SeekableReader | None = None,
    mesh: tuple[str, SeekableReader] | None = None,
    companions: Mapping[str, bytes] | None = None,
) -> Capture:
    """Read a cloud with its mask and mesh, in metres and +Z up.

    Args:
        stream: the cloud's file, at its start.
        file_type: as `source_kind` returns it.
        reading: the file's axis and unit; by default its format's convention and, for scans, 1 m. A splat of unknown
            axes is levelled; one of unknown unit is scaled to a height of 5 m.
        mask: which Gaussians may move (`names.MASK_NAME`).
        mesh: name and content of a mesh at the cloud's place, in the same axes and units.
        companions: files that the mesh, or the `meta.json` of a SOG folder, may name.

    Raises:
        InputError: one of the files cannot be read, or they do not fit together.
    """
    assert file_type in CLOUD_TYPES
    reading = reading or Reading()
    if file_type == "sog" and is_folder_file(stream):
        stream = bundled(stream, companions or {})
    facts = cloud_facts(stream, file_type=file_type)
    cloud = read_cloud(stream, file_type=file_type, up_axis=reading.up_axis, unit_m=reading.unit_m)
    movable = None if mask is None else read_mask(mask)
    capture = plant_of_cloud(cloud, reading, facts, mask=movable, tell_trees=mesh is None)
    cloud = capture.cloud
    remarks = offset_warnings(cloud.source.offset) + _warnings(cloud, file_type, reading)
    capture = replace(capture, warnings=capture.warnings + remarks)
    if mesh is None:
        return capture
    name, content = mesh
    kind, mesh_type = source_kind(content, name)
    if kind != "mesh":
        raise FormatError(
            f"{name!r} is a cloud, and so is the file beside it; send one cloud, and a mesh if you have one"
        )
    beside = read_mesh(
        BytesIO(content.read()),
        file_type=mesh_type,
        reading=Reading(up_axis=cloud.source.up_axis, unit_m=cloud.source.scale),
        companions=companions,
    )
    apart = np.subtract(beside.source.offset, cloud.source.offset)  # each file has an offset of its own
    moved = beside.vertices + (up_rotation(cloud.source.up_axis) @ apart * cloud.source.scale)
    return replace(
        capture,
        mesh=replace(
            beside, vertices=moved.astype(np.float32), source=replace(beside.source, offset=cloud.source.offset)
        ),
    )


def _warnings(cloud: GaussianCloud, file_type: str, reading: Reading) -> tuple[SourceWarning, ...]:
    """Return warnings about omitted rows of a cloud, and about a unit that the file of a scan states."""
    remarks = []
    if cloud.dropped:
        message = f"{cloud.dropped:,} rows that are not finite, or that the file marks as noise, were left out"
        remarks.append(SourceWarning(code="rows-left-out", message=message))
    if file_type in ("las", "laz") and cloud.source.scale != 1 and reading.unit_m is None and not reading.height_m:
        message = (
            f"the scan's coordinate system is in units of {cloud.source.scale:.7g} m, which became metres; set unit_m "
            "to 1 if its numbers are metres all the same"
        )
        remarks.append(SourceWarning(code="unit-of-the-file", message=message))
    return tuple(remarks)


def read_mask(stream: SeekableReader) -> Bool[np.ndarray, " G"]:
    """Read a mask.

    Raises:
        FormatError: no `.npy` file, too large, or not one row of bools or of 0 and 1.
    """
    max_header_bytes = 4096
    size = remaining_bytes(stream)
    if size > MAX_GAUSSIANS + max_header_bytes:
        raise FormatError(f"the mask is {size:,} bytes; a byte a Gaussian, at most {MAX_GAUSSIANS:,}, is allowed")
    try:
        mask = np.lib.format.read_array(stream, allow_pickle=False, max_header_size=max_header_bytes)
    except (ValueError, EOFError, MemoryError) as error:
        raise FormatError(f"the mask is no .npy file: {str(error)[:200]}") from error
    if mask.dtype.name not in ("bool", "uint8") or mask.ndim != 1 or (mask.size and mask.max() > 1):
        value = f"{mask.dtype.name} {list(mask.shape)}"
        raise FormatError(f"the mask is {value}; one row of bool, or of uint8 that are 0 or 1, is allowed")
    result: Bool[np.ndarray, " G"] = mask.astype(np.bool_)
    return result
