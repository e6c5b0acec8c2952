"""SPZ files of Niantic Labs: 16 to 20 bytes per Gaussian, and harmonics in 8 bits, then compressed.

Versions 2 and 3 are one gzip stream, version 4 a plain header and one zstandard stream per attribute. +Y is up.
"""

import struct
import zlib

import numpy as np
import zstandard
from jaxtyping import Float32, Num, UInt8

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader, refuse_bomb
from dynamictree.formats.splat.activations import (
    color_from_harmonic,
    drop_largest,
    harmonic_from_color,
    log_from_scales,
    restore_largest,
    scales_from_log,
)
from dynamictree.gaussian.axes import to_source_axes
from dynamictree.gaussian.cloud import GaussianCloud, check_count
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.rotation import unit_quaternions

UP_AXIS = "+Y"
_MAGIC = 0x5053474E  # "NGSP"
_LEGACY_HEADER = struct.Struct("<IIIBBBB")
_HEADER = struct.Struct("<IIIBBBBI12x")
_COLOR_SCALE = 0.15  # scale from the coefficient of degree 0 to the stored colour
_SMALLEST_THREE = (1 << 9) - 1  # number of steps for the magnitude of a quaternion's smaller component


def read_spz(stream: SeekableReader) -> GaussianCloud:
    """Read version 2, 3 or 4; extensions are ignored.

    Raises:
        FormatError: not SPZ, an unknown version, damaged or truncated.
        InputError: too many Gaussians.
    """
    head = stream.read(_HEADER.size)
    if head[:2] == b"\x1f\x8b":
        return _read_gzip(head + stream.read())
    if len(head) == _HEADER.size and head[:4] == b"NGSP":
        return _read_zstandard(head, stream)
    raise FormatError("the file begins neither with 'NGSP' nor as gzip; it is no SPZ file, or truncated")


def write_spz(cloud: GaussianCloud, stream: ByteWriter) -> None:
    """Write version 3, which every reader supports, in the source's units and +Y up.

    Positions are rounded to 1/4096 of a unit, or more coarsely if they reach beyond ±2048.
    """
    source = to_source_axes(cloud, UP_AXIS)
    reach = max(float(np.abs(source.means).max()), 1e-30)
    fractional_bits = int(np.clip(np.floor(np.log2((2**23 - 1) / reach)), 0, 12))
    header = _LEGACY_HEADER.pack(_MAGIC, 3, source.num_gaussians, source.sh_degree, fractional_bits, 0, 0)
    body = b"".join(part.tobytes() for part in _packed(source, fractional_bits))
    packer = zlib.compressobj(6, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    stream.write(packer.compress(header + body) + packer.flush())


def _read_gzip(content: bytes) -> GaussianCloud:
    unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        head = unpacker.decompress(content, _LEGACY_HEADER.size)
        if len(head) < _LEGACY_HEADER.size:
            raise FormatError("the SPZ file ends within its header; it is truncated")
        magic, version, count, degree, fractional_bits, _, _ = _LEGACY_HEADER.unpack(head)
        if magic != _MAGIC or version not in (2, 3):
            raise FormatError(f"the gzip stream is no SPZ file of version 2 or 3 (magic {magic:#x}, version {version})")
        sizes = _sizes(count, degree, version)
        refuse_bomb(f"the SPZ file of {count:,} Gaussians", sum(sizes), len(content))
        body = unpacker.decompress(unpacker.unconsumed_tail, sum(sizes))
    except zlib.error as error:
        raise FormatError(f"the SPZ file is damaged: {error}") from error
    if len(body) < sum(sizes):
        raise FormatError(f"the SPZ file ends after {len(body):,} of {sum(sizes):,} bytes; it is truncated")
    parts = np.split(np.frombuffer(body, np.uint8), np.cumsum(sizes)[:-1])
    return _unpacked(parts, fractional_bits, version)


def _read_zstandard(head: bytes, stream: SeekableReader) -> GaussianCloud:
    _, version, count, degree, fractional_bits, _, num_streams, table_offset = _HEADER.unpack(head)
    if version != 4:
        raise FormatError(f"the SPZ file is of version {version}; 2, 3 and 4 are understood")
    sizes = _sizes(count, degree, version)
    content = head + stream.read()
    refuse_bomb(f"the SPZ file of {count:,} Gaussians", sum(sizes), len(content))
    expected_streams = 6 if degree else num_streams  # a writer may leave out the empty stream of harmonics
    if num_streams not in (5, 6) or num_streams != expected_streams or table_offset < _HEADER.size:
        raise FormatError(
            f"the SPZ header names {num_streams} streams at byte {table_offset}; six behind the header are needed"
        )
    table_end = table_offset + 16 * num_streams
    if table_end > len(content):
        raise FormatError(f"the SPZ file ends after {len(content):,} bytes, within its table; it is truncated")
    table = np.frombuffer(content[table_offset:table_end], "<u8").reshape(num_streams, 2).astype(object)
    parts, place = list[UInt8[np.ndarray, "..."]](), table_end
    for (packed_size, size), expected in zip(table, sizes, strict=False):
        if size != expected or place + packed_size > len(content):
            raise FormatError(
                f"an SPZ stream is {size:,} bytes, or runs past the file's end; {count:,} Gaussians need {expected:,}"
            )
        parts.append(_decompressed(content[place : place + packed_size], expected))
        place += packed_size
    return _unpacked([*parts, np.empty(0, np.uint8)][:6], fractional_bits, version)


def _decompressed(packed: bytes, size: int) -> UInt8[np.ndarray, " bytes"]:
    if size == 0:
        return np.empty(0, np.uint8)
    try:
        with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
            content = reader.read(size)
    except zstandard.ZstdError as error:
        raise FormatError(f"the SPZ file is damaged: {error}") from error
    if len(content) < size:
        raise FormatError(f"an SPZ stream ends after {len(content):,} of {size:,} bytes; the file is truncated")
    return np.frombuffer(content, np.uint8)


def _sizes(count: int, degree: int, version: int) -> list[int]:
    """Return the sizes of positions, alphas, colours, scales, rotations and harmonics [bytes]."""
    if degree > 3:
        raise FormatError(f"the SPZ file has harmonics of degree {degree}; 0 to 3 are understood")
    check_count(count)
    rotation = 3 if version == 2 else 4
    return [9 * count, count, 3 * count, 3 * count, rotation * count, 3 * ((degree + 1) ** 2 - 1) * count]


def _unpacked(parts: list[UInt8[np.ndarray, "..."]], fractional_bits: int, version: int) -> GaussianCloud:
    if fractional_bits > 23:
        raise FormatError(f"the SPZ header gives positions {fractional_bits} fractional bits; they have 24 bits in all")
    positions, alphas, colors, scales, rotations, harmonics = parts
    count = len(alphas)
    low, middle, high = positions.reshape(count, 3, 3).astype(np.int32).transpose(2, 0, 1)
    fixed = (low | middle << 8 | high << 16) << 8 >> 8  # sign extension
    color = (colors.reshape(count, 3) / np.float32(255) - 0.5) / _COLOR_SCALE * SH_0 + 0.5
    rest = (harmonics.reshape(count, -1, 3).astype(np.float32) - 128) / 128
    quaternions = _first_three(rotations) if version == 2 else _smallest_three(rotations)
    return GaussianCloud(
        means=(fixed / np.float64(1 << fractional_bits)).astype(np.float32),
        quaternions=unit_quaternions(quaternions),
        scales=scales_from_log(scales.reshape(count, 3) / np.float32(16) - 10),
        opacity=alphas / np.float32(255),
        sh=np.concatenate([harmonic_from_color(color)[:, None], rest], axis=1),
    )


def _packed(cloud: GaussianCloud, fractional_bits: int) -> list[UInt8[np.ndarray, "..."]]:
    sh_bits = {1: 5, 2: 4, 3: 4}  # precision by degree, as in the reference writer
    fixed = np.rint(cloud.means.astype(np.float64) * (1 << fractional_bits)).astype(np.int32)
    positions = np.stack([fixed & 0xFF, fixed >> 8 & 0xFF, fixed >> 16 & 0xFF], axis=2)  # [G, 3, 3]
    color = (color_from_harmonic(cloud.sh[:, 0]) - 0.5) / SH_0 * _COLOR_SCALE + 0.5
    harmonics = [
        _round(cloud.sh[:, degree**2 : (degree + 1) ** 2], sh_bits[degree]) for degree in range(1, cloud.sh_degree + 1)
    ]
    rest = np.concatenate([np.empty((cloud.num_gaussians, 0, 3)), *harmonics], axis=1)
    return [
        _bytes(positions),
        _bytes(cloud.opacity * 255),
        _bytes(color * 255),
        _bytes((log_from_scales(cloud.scales) + 10) * 16),
        _packed_smallest_three(cloud.quaternions),
        _bytes(rest),
    ]


def _bytes(values: Num[np.ndarray, "G ..."]) -> UInt8[np.ndarray, "G bytes"]:
    result: UInt8[np.ndarray, "G bytes"] = np.clip(np.rint(values), 0, 255).astype(np.uint8).reshape(len(values), -1)
    return result


def _round(coefficients: Float32[np.ndarray, "G D 3"], bits: int) -> Float32[np.ndarray, "G D 3"]:
    """Round coefficients to fewer values, for better compression; zero stays zero."""
    bucket = 1 << 8 - bits
    return np.asarray((np.rint(coefficients * 128 + 128) + bucket // 2) // bucket * bucket, np.float32)


def _first_three(packed: UInt8[np.ndarray, " bytes"]) -> Float32[np.ndarray, "G 4"]:
    xyz = packed.reshape(-1, 3) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (xyz * xyz).sum(axis=1)))
    return np.concatenate([w[:, None], xyz], axis=1).astype(np.float32)


def _smallest_three(packed: UInt8[np.ndarray, " bytes"]) -> Float32[np.ndarray, "G 4"]:
    """Unpack quaternions: 2 bits name the largest of x, y, z, w; 10 (sign, magnitude) store each other, last lowest."""
    bits = packed.view("<u4").astype(np.uint32)
    stored = np.stack([bits >> 20 & 1023, bits >> 10 & 1023, bits & 1023], axis=1)
    magnitude = (stored & _SMALLEST_THREE) / np.float32(_SMALLEST_THREE * np.sqrt(2))
    others = np.where(stored >> 9, -magnitude, magnitude).astype(np.float32)
    return restore_largest(others, (bits >> 30).astype(np.intp))[:, [3, 0, 1, 2]]


def _packed_smallest_three(quaternions: Float32[np.ndarray, "G 4"]) -> UInt8[np.ndarray, "G 4"]:
    others, largest = drop_largest(quaternions[:, [1, 2, 3, 0]])
    steps = np.minimum(np.rint(np.abs(others) * np.sqrt(2) * _SMALLEST_THREE), _SMALLEST_THREE).astype(np.uint32)
    stored = steps | (others < 0).astype(np.uint32) << 9
    bits = largest.astype(np.uint32) << 30 | stored[:, 0] << 20 | stored[:, 1] << 10 | stored[:, 2]
    result: UInt8[np.ndarray, "G 4"] = bits.astype("<u4").view(np.uint8).reshape(-1, 4)
    return result
