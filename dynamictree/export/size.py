"""Size of files that grow with the number of frames, known before they are written."""

from collections.abc import Iterable

from dynamictree.errors import InputError
from dynamictree.formats.motion.splat_sequence import requested_bytes
from dynamictree.formats.motion.usd_splat import usd_splat_bytes
from dynamictree.gaussian.cloud import MAX_SEQUENCE_BYTES, level_count
from dynamictree.requests import ExportParams, Format


def turbulent_bytes(
    formats: Iterable[Format], *, num_vertices: int, num_faces: int, num_frames: int
) -> dict[Format, int]:
    """Least size of the files that hold every frame of a mesh in turbulent wind [bytes].

    Raises:
        InputError: one would be too large.
    """
    per_frame = {
        "ply": 12 * num_vertices + 13 * num_faces,
        "motion": 12 * num_vertices,
        "usd": 12 * num_vertices,  # points; what stays is small beside them
        "alembic": 12 * num_vertices,
    }
    sizes = {name: per_frame[name] * num_frames for name in formats if name in per_frame}
    for name, size in sizes.items():
        if size > MAX_SEQUENCE_BYTES:
            raise InputError(
                f"{num_frames} frames of {num_vertices:,} vertices as {name} are {size / 1e9:.1f} GB, above "
                f"{MAX_SEQUENCE_BYTES / 1e9:.1f} GB: ask for fewer frames, or evaluate /v1/spectra/{{id}}/wind"
            )
    return sizes


def splat_bytes(num_gaussians: int, sh_degree: int, num_frames: int, params: ExportParams) -> dict[Format, int]:
    """Size of the asked files that hold every frame of a splat, the least one of USD [bytes].

    Raises:
        InputError: one would be too large.
    """
    sizes: dict[Format, int] = {}
    if "splat-ply" in (params.formats or ()):
        sizes["splat-ply"] = requested_bytes(num_gaussians, sh_degree, num_frames, params)
    if "usd-splat" in (params.formats or ()):
        sizes["usd-splat"] = usd_splat_bytes(level_count(num_gaussians, params.share), num_frames)
    return sizes
