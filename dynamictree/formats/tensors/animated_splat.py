"""`*.animated-splat.safetensors`: a cloud at rest, its binding to a mesh, and the spectrum that moves it.

The format is described in docs/formats-splat.md. Everything is in metres and +Z up. A capture of 500,000 Gaussians
of SH degree 3 takes about 85 MB, its 100 frames as PLY 12.4 GB.
"""

import json
from dataclasses import asdict

import numpy as np
from jaxtyping import Float32, Shaped

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import NumericsError
from dynamictree.formats.tensors.container import write_tensors
from dynamictree.gaussian.animate import AnimatedSplat
from dynamictree.gaussian.binding import STILL

FORMAT = "animated-splat"
VERSION = "1"
_HALF = float(np.finfo(np.float16).max)


def write_animated_splat(splat: AnimatedSplat, stream: ByteWriter) -> None:
    """Write a splat; positions and scales as float32, the rest as float16.

    Raises:
        NumericsError: a coefficient or harmonic is not finite, or too large for float16.
    """
    binding, cloud = splat.binding, splat.binding.cloud
    faces, face_of = np.unique(binding.face_of, return_inverse=True)  # those that carry a Gaussian
    first = int(faces[0] == STILL)
    used, corner = np.unique(binding.triangles[faces[first:]], return_inverse=True)
    coefficients = splat.coefficients[used]
    parts = np.stack([coefficients.real, coefficients.imag], axis=-1)  # [N, K, 3, 2]
    tensors: dict[str, Shaped[np.ndarray, ...]] = {
        "means": cloud.means,
        "scales": cloud.scales,
        "quaternions": cloud.quaternions.astype(np.float16),
        "opacity": cloud.opacity.astype(np.float16),
        "sh": _halves("sh", cloud.sh),
        "vertices": binding.vertices[used],
        "triangles": corner.reshape(-1, 3).astype(np.int32),
        "face_of": (face_of - first).astype(np.int32),
        "weights": binding.weights.astype(np.float16),
        "coefficients": _halves("coefficients", parts),
    }
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "fps": repr(float(splat.fps)),
        "num_frames": str(splat.num_frames),
        "source_up_axis": cloud.source.up_axis,
        "source_scale": repr(float(cloud.source.scale)),
    }
    if (flutter := splat.flutter) is not None and (leaves := binding.leaves) is not None:
        vertex = np.searchsorted(used, leaves.vertex).astype(np.int32)
        tensors |= {"leaf_of": leaves.of, "leaf_vertex": vertex, **flutter.tensors}
        tensors["leaf_size"] = flutter.sizes(flutter.gusts_m_s)
        metadata["wind"] = json.dumps(asdict(flutter.wind))
    write_tensors(stream, tensors, metadata)


def _halves(name: str, values: Float32[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    largest = float(np.abs(values).max(initial=0))
    if not largest <= _HALF:
        raise NumericsError(f"the largest of {name} is {largest:.4g}; float16 holds at most {_HALF:g}")
    return values.astype(np.float16)
