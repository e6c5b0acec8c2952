"""Sizes of files that grow with the number of frames, computed before they are written."""

from collections.abc import Iterable

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import MAX_SEQUENCE_BYTES, level_count
from dynamictree.requests import ExportParams, Format


def min_sequence_bytes(
    formats: Iterable[Format],
    num_frames: int,
    params: ExportParams,
    *,
    mesh: tuple[int, int] = (0, 0),
    cloud: tuple[int, int] = (0, 0),
) -> dict[Format, int]:
    """Return the least size of files with every frame [bytes]; what does not grow with the frames is small.

    Formats of constant size have no entry. `mesh` has the numbers of vertices and faces, `cloud` the number of
    Gaussians and their degree of harmonics.

    Raises:
        InputError: a file would be too large.
    """
    vertices, faces = mesh
    gaussians, degree = level_count(cloud[0], params.share), min(cloud[1], params.sh_degree)
    per_frame: dict[Format, int] = {
        "ply": 12 * vertices + 13 * faces,
        "motion": 12 * vertices,
        "usd": 12 * vertices,
        "alembic": 12 * vertices,
        "splat-ply": 4 * (14 + 3 * (degree + 1) ** 2) * gaussians,
        "usd-splat": (12 + 8) * gaussians,  # positions in floats, rotations in half floats
    }
    sizes = {name: per_frame[name] * num_frames for name in formats if name in per_frame}
    for name, size in sizes.items():
        if size > MAX_SEQUENCE_BYTES:
            of_splat = name in ("splat-ply", "usd-splat")
            what = f"{gaussians:,} Gaussians of SH degree {degree}" if of_splat else f"{vertices:,} vertices"
            advice = "a lower sh_degree or share, or for the format splat" if of_splat else "or for the format glb"
            raise InputError(
                f"{num_frames} frames of {what} as {name} are {size / 1e9:.1f} GB, above "
                f"{MAX_SEQUENCE_BYTES / 1e9:.1f} GB: ask for fewer frames, {advice}"
            )
    return sizes
