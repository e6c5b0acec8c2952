"""Compressed PLY files of PlayCanvas' SuperSplat: 16 bytes per Gaussian, quantised in the bounds of chunks of 256."""

import numpy as np
from jaxtyping import Float32, Shaped, UInt32

from dynamictree.errors import FormatError
from dynamictree.formats.ply_table import PlyHeader, read_elements, read_header
from dynamictree.formats.seekable import SeekableReader
from dynamictree.formats.splat.activations import harmonic_from_color, restore_largest, scales_from_log
from dynamictree.formats.splat.ply import rest_names
from dynamictree.gaussian.cloud import GaussianCloud, check_count
from dynamictree.rotation import unit_quaternions

_CHUNK = 256  # Gaussians
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_BOUNDS = tuple(
    f"{side}_{name}" for name in ("x", "y", "z", "scale_x", "scale_y", "scale_z") for side in ("min", "max")
)
_COLOR_BOUNDS = tuple(f"{side}_{name}" for name in "rgb" for side in ("min", "max"))


def is_compressed(header: PlyHeader) -> bool:
    """Whether a PLY file is a compressed splat."""
    vertex = header.element("vertex")
    return header.element("chunk") is not None and vertex is not None and vertex.names.issuperset(_PACKED)


def read_compressed_ply(stream: SeekableReader) -> GaussianCloud:
    """Read a cloud with or without harmonics.

    Raises:
        FormatError: not a compressed splat, chunks that do not fit the vertices, or truncated.
        InputError: too many Gaussians.
    """
    header = read_header(stream)
    chunk, vertex, sh = (header.element(name) for name in ("chunk", "vertex", "sh"))
    if chunk is None or vertex is None or not is_compressed(header) or not chunk.names.issuperset(_BOUNDS):
        raise FormatError("the PLY file is no compressed splat: chunk bounds or packed vertices are missing")
    check_count(vertex.count)
    if chunk.count != -(-vertex.count // _CHUNK) or (sh is not None and sh.count != vertex.count):
        raise FormatError(
            f"the compressed PLY has {chunk.count:,} chunks and {sh.count if sh else 0:,} rows of harmonics for "
            f"{vertex.count:,} Gaussians; a chunk for every {_CHUNK} and a row for each are needed"
        )
    names = ["chunk", "vertex"] if sh is None else ["chunk", "vertex", "sh"]
    chunks, packed, *harmonics = read_elements(stream, header, *names)
    color, opacity = _color(chunks, packed)
    first = harmonic_from_color(color)[:, None]
    rest = [_harmonics(rows, rest_names(sh.names)) for rows in harmonics] if sh else []
    return GaussianCloud(
        means=_between(chunks, ("x", "y", "z"), _unpack_11_10_11(packed["packed_position"])),
        quaternions=unit_quaternions(_rotation(packed["packed_rotation"])),
        scales=scales_from_log(
            _between(chunks, ("scale_x", "scale_y", "scale_z"), _unpack_11_10_11(packed["packed_scale"]))
        ),
        opacity=opacity,
        sh=np.concatenate([first, *rest], axis=1),
    )


def _between(
    chunks: Shaped[np.ndarray, " chunks"], names: tuple[str, ...], share: Float32[np.ndarray, "G 3"]
) -> Float32[np.ndarray, "G 3"]:
    """Convert shares of each chunk's range to values."""
    of = np.arange(len(share)) // _CHUNK
    low, high = (np.stack([chunks[f"{side}_{name}"] for name in names], axis=1)[of] for side in ("min", "max"))
    return np.asarray(low + (high - low) * share, np.float32)


def _unpack_11_10_11(bits: UInt32[np.ndarray, " G"]) -> Float32[np.ndarray, "G 3"]:
    stored = np.stack([bits >> 21, bits >> 11 & 1023, bits & 2047], axis=1).astype(np.float32)
    return stored / np.array([2047, 1023, 2047], np.float32)


def _rotation(bits: UInt32[np.ndarray, " G"]) -> Float32[np.ndarray, "G 4"]:
    """Unpack quaternions: 2 bits name the largest of w, x, y, z; 10 bits store each other component, in ±1/√2."""
    others = np.stack([bits >> 20 & 1023, bits >> 10 & 1023, bits & 1023], axis=1).astype(np.float32)
    others = (others / np.float32(1023) - 0.5) * np.float32(np.sqrt(2))  # [G, 3]
    return restore_largest(others, (bits >> 30).astype(np.intp))


def _color(
    chunks: Shaped[np.ndarray, " chunks"], packed: Shaped[np.ndarray, " G"]
) -> tuple[Float32[np.ndarray, "G 3"], Float32[np.ndarray, " G"]]:
    bits = packed["packed_color"]
    rgba = np.stack([bits >> 24, bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1).astype(np.float32) / 255
    color = np.ascontiguousarray(rgba[:, :3])
    if set(_COLOR_BOUNDS) <= set(chunks.dtype.names or ()):
        color = _between(chunks, ("r", "g", "b"), color)
    return color, np.ascontiguousarray(rgba[:, 3])


def _harmonics(rows: Shaped[np.ndarray, " G"], names: list[str]) -> Float32[np.ndarray, "G D 3"]:
    """Convert bytes to coefficients: 0 and 255 are the ends of the range, others the middles of their bins."""
    sh_range = 8.0  # harmonics lie within ±4
    stored = np.stack([rows[name] for name in names], axis=1).astype(np.float32)
    share = np.where(stored == 0, 0, np.where(stored == 255, 1, (stored + 0.5) / 256))
    coefficients = (share - 0.5) * np.float32(sh_range)
    return np.ascontiguousarray(coefficients.reshape(len(rows), 3, -1).transpose(0, 2, 1)).astype(np.float32)
