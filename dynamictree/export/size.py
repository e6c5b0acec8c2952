"""Size of files that grow with the number of frames, known before they are written."""

from collections.abc import Iterable

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import MAX_SEQUENCE_BYTES
from dynamictree.requests import Format


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
