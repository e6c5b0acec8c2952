"""A cloud's motion as one 3DGS PLY per frame: the paper's output.

Frames are in the source's axes and units, at the place of the capture. Files are produced one by one: 500,000
Gaussians × 100 frames of SH degree 3 are 12.4 GB.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.formats.splat.ply import ply_header, ply_rows
from dynamictree.gaussian.animate import NO_FLUTTER, LeafTurns, iter_splat_frames
from dynamictree.gaussian.axes import to_source_axes
from dynamictree.gaussian.binding import Binding
from dynamictree.up_axis import up_rotation


def iter_splat_files(
    binding: Binding,
    displacements: Iterable[Float32[np.ndarray, "N 3"]],
    leaf_turns: LeafTurns = NO_FLUTTER,
    *,
    first_number: int = 0,
) -> Iterator[tuple[str, tuple[bytes, ...]]]:
    """Yield name and content, in parts, of frame_0000.ply, …, in the cloud's order.

    Displacements of the mesh's vertices [m] are consumed one by one. For a level of detail or a lower SH degree, see
    `animate.reduced_splat`; for a range of frames, pass only their displacements and the first frame's number.
    """
    source, to_source = _in_source_axes(binding)
    header = ply_header(source.cloud.num_gaussians, source.cloud.sh.shape[1])
    moved = ((displacement @ to_source).astype(np.float32) for displacement in displacements)
    axes = up_rotation(binding.cloud.source.up_axis).astype(np.float32)
    turned = (None if turns is None else turns @ axes for turns in leaf_turns)
    for number, frame in enumerate(iter_splat_frames(source, moved, turned), first_number):
        yield f"frame_{number:04d}.ply", (header, ply_rows(frame).tobytes())


def _in_source_axes(binding: Binding) -> tuple[Binding, Float64[np.ndarray, "3 3"]]:
    """Return the binding in the source's axes and units, and the matrix that converts displacements (rows) to them."""
    cloud = binding.cloud
    to_source = up_rotation(cloud.source.up_axis) / cloud.source.scale
    source = replace(binding, cloud=to_source_axes(cloud), vertices=(binding.vertices @ to_source).astype(np.float32))
    return source, to_source
