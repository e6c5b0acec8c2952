"""A cloud's motion as one 3DGS PLY a frame in a ZIP that streams: the paper's output.

Frames are in the source's axes and units, so that they lie where the capture lay. Only what moves is worked out anew;
500,000 Gaussians × 100 frames of SH degree 3 are 12.4 GB and never in memory.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.errors import InputError
from dynamictree.formats.splat.activations import log_from_scales
from dynamictree.formats.splat.ply import ply_header, ply_rows
from dynamictree.formats.stored_zip import iter_stored_zip, stored_zip_bytes
from dynamictree.gaussian.animate import iter_poses
from dynamictree.gaussian.axes import to_source_axes
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.cloud import MAX_SEQUENCE_BYTES, level_count
from dynamictree.gaussian.deform import Pose
from dynamictree.requests import ExportParams
from dynamictree.up_axis import up_rotation


def iter_splat_sequence_zip(
    binding: Binding, displacements: Iterable[Float32[np.ndarray, "N 3"]], *, first_number: int = 0
) -> Iterator[bytes]:
    """Chunks of the archive; displacements of the mesh's vertices [m] are asked for one by one.

    Entries are frame_0000.ply and so on, in the cloud's order. For a level of detail or a lower SH degree, see
    `animate.lighter`; for a range of frames, give only their displacements and the first one's number.
    """
    source, to_source = _in_source_axes(binding)
    header = ply_header(source.cloud.num_gaussians, source.cloud.sh.shape[1])
    rows = ply_rows(source.cloud)
    moved = ((displacement @ to_source).astype(np.float32) for displacement in displacements)
    yield from iter_stored_zip(
        (f"frame_{number:04d}.ply", (header, _frame(source, pose, rows)))
        for number, pose in enumerate(iter_poses(source, moved), first_number)
    )


def splat_sequence_bytes(num_gaussians: int, sh_degree: int, num_frames: int, *, first_number: int = 0) -> int:
    """Exact size of the archive, known before it is written."""
    num_harmonics = (sh_degree + 1) ** 2
    size = len(ply_header(num_gaussians, num_harmonics)) + num_gaussians * 4 * (17 + 3 * (num_harmonics - 1))
    return stored_zip_bytes((f"frame_{first_number + n:04d}.ply", size) for n in range(num_frames))


def requested_bytes(num_gaussians: int, sh_degree: int, num_frames: int, params: ExportParams) -> int:
    """Exact size of the archive that a request asks for.

    Raises:
        InputError: it would be too large.
    """
    count, degree = level_count(num_gaussians, params.share), min(sh_degree, params.sh_degree)
    size = splat_sequence_bytes(count, degree, num_frames, first_number=params.first_frame)
    if size > MAX_SEQUENCE_BYTES:
        raise InputError(
            f"{num_frames} frames of {count:,} Gaussians of SH degree {degree} are {size / 1e9:.1f} GB, above "
            f"{MAX_SEQUENCE_BYTES / 1e9:.1f} GB: ask for fewer frames, a lower sh_degree or share, or for the format "
            "splat"
        )
    return size


def _frame(binding: Binding, pose: Pose, rows: Float32[np.ndarray, "G P"]) -> bytes:
    """Body of one file; `rows` are those of rest and are overwritten where something moves."""
    from dynamictree.gaussian.turn import turn_sh_rows

    cloud = binding.cloud
    rows[:, 0:3] = pose.means
    turn_sh_rows(cloud.sh, cloud.quaternions, pose.quaternions, rows)
    rows[:, -7:-4] = log_from_scales(pose.scales)
    rows[:, -4:] = pose.quaternions
    return rows.tobytes()


def _in_source_axes(binding: Binding) -> tuple[Binding, Float64[np.ndarray, "3 3"]]:
    """The same binding where the capture lay, and what takes a displacement there (as a row, from the right)."""
    cloud = binding.cloud
    to_source = up_rotation(cloud.source.up_axis) / cloud.source.scale
    source = replace(binding, cloud=to_source_axes(cloud), vertices=(binding.vertices @ to_source).astype(np.float32))
    return source, to_source
