"""`*.animated-splat.safetensors`: a cloud at rest, what it hangs on, and the spectrum that moves it.

Described for other readers in docs/formats-splat.md. Everything is in metres and +Z up. A capture of 500,000 Gaussians
of SH degree 3 takes about 85 MB, its 100 frames as PLY 12.4 GB.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float32, Shaped

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.errors import FormatError, NumericsError
from dynamictree.formats.tensors.container import MAX_FRAMES, integer, number, read_tensors, take_tensor, write_tensors
from dynamictree.gaussian.animate import AnimatedSplat, without_idle_vertices
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.cloud import SH_DEGREES, GaussianCloud, check_count, validate_cloud
from dynamictree.rotation import unit_quaternions
from dynamictree.source import Source
from dynamictree.up_axis import up_rotation

FORMAT = "animated-splat"
VERSION = "1"
_HALF = float(np.finfo(np.float16).max)


def write_animated_splat(splat: AnimatedSplat, stream: ByteWriter) -> None:
    """Write; positions and scales as float32, the rest as float16.

    Raises:
        NumericsError: a coefficient or harmonic is not finite, or larger than float16 can hold.
    """
    compact = without_idle_vertices(splat)
    binding, cloud = compact.binding, compact.binding.cloud
    parts = np.stack([compact.coefficients.real, compact.coefficients.imag], axis=-1)  # [N, K, 3, 2]
    tensors: dict[str, Shaped[np.ndarray, ...]] = {
        "means": cloud.means,
        "scales": cloud.scales,
        "quaternions": cloud.quaternions.astype(np.float16),
        "opacity": cloud.opacity.astype(np.float16),
        "sh": _halves("sh", cloud.sh),
        "vertices": binding.vertices,
        "triangles": binding.triangles,
        "face_of": binding.face_of,
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
    write_tensors(stream, tensors, metadata)


def read_animated_splat(stream: ByteReader) -> AnimatedSplat:
    """Read; undoes `write_animated_splat` to the precision of float16.

    Raises:
        InputError: no such file of a known version, or anything in it is out of range.
    """
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION)
    count = len(tensors["means"]) if "means" in tensors and tensors["means"].ndim else 0
    check_count(count)
    cloud = _read_cloud(tensors, metadata, count)
    vertices = _floats(tensors, "vertices", (None, 3))
    parts = _floats(tensors, "coefficients", (len(vertices), None, 3, 2))
    weights = _floats(tensors, "weights", (count, 3))
    if np.abs(weights).max(initial=0) > 1.01:
        raise FormatError("barycentric weights of the animated splat leave 0 to 1")
    binding = Binding(
        cloud=cloud,
        vertices=vertices,
        triangles=take_tensor(tensors, "triangles", dtypes=("int32",), shape=(None, 3)),
        face_of=take_tensor(tensors, "face_of", dtypes=("int32",), shape=(count,)),
        weights=weights,
    )
    return AnimatedSplat(
        binding=binding,
        coefficients=np.ascontiguousarray(parts).view(np.complex64)[..., 0],
        num_frames=integer(metadata, "num_frames", low=1, high=MAX_FRAMES),
        fps=number(metadata, "fps"),
    )


def _read_cloud(
    tensors: Mapping[str, Shaped[np.ndarray, "..."]], metadata: Mapping[str, str], count: int
) -> GaussianCloud:
    sh = _floats(tensors, "sh", (count, None, 3))
    if sh.shape[1] not in SH_DEGREES:
        raise FormatError(f"the animated splat has {sh.shape[1]} harmonics a Gaussian; 1, 4, 9 or 16 are allowed")
    up_axis = metadata.get("source_up_axis", "+Z")
    up_rotation(up_axis)
    scale = number(metadata, "source_scale")
    if scale <= 0:
        raise FormatError(f"source_scale of the animated splat is {scale:g}; it must be positive")
    return validate_cloud(
        GaussianCloud(
            means=_floats(tensors, "means", (count, 3)),
            quaternions=unit_quaternions(_floats(tensors, "quaternions", (count, 4))),
            scales=_floats(tensors, "scales", (count, 3)),
            opacity=_floats(tensors, "opacity", (count,)),
            sh=sh,
            source=Source(up_axis=up_axis, scale=scale),
        )
    )


def _floats(
    tensors: Mapping[str, Shaped[np.ndarray, "..."]], name: str, shape: tuple[int | None, ...]
) -> Float32[np.ndarray, "..."]:
    stored = take_tensor(tensors, name, dtypes=("float16", "float32"), shape=shape)
    return stored.astype(np.float32)


def _halves(name: str, values: Float32[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    largest = float(np.abs(values).max(initial=0))
    if not largest <= _HALF:
        raise NumericsError(f"the largest of {name} is {largest:.4g}; float16 holds at most {_HALF:g}")
    return values.astype(np.float16)
