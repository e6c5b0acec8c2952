""".ksplat files of GaussianSplats3D, version 0.1: sections of Gaussians, whose places are steps within buckets.

Level 0 of compression is floats, level 1 halves with 16-bit steps, level 2 the same with harmonics of 8 bits.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.formats.splat.activations import harmonic_from_color
from dynamictree.gaussian.cloud import GaussianCloud, check_count, joined
from dynamictree.rotation import unit_quaternions

UP_AXIS = "-Y"
_HEADER = struct.Struct("<BBxxIIIIHxx12xff")
_HEADER_BYTES = 4096
_SECTION = struct.Struct("<IIIIfHxxI4xIIH")
_SECTION_BYTES = 1024
_PLACE_BYTES = {0: ("<f4", "<f4", "<f4"), 1: ("<u2", "<f2", "<f2"), 2: ("<u2", "<f2", "u1")}
"""Of a level: the types of places, of scales and rotations, and of harmonics."""
_FARTHEST = 1e6  # of a bucket's size and of what harmonics of 8 bits may be


@dataclass(frozen=True, kw_only=True)
class _Section:
    """One section's header, and where its parts begin in the file [bytes]."""

    count: int
    per_bucket: int
    num_buckets: int
    num_full: int
    num_partial: int
    block_m: float
    steps: int
    degree: int
    buckets_at: int  # behind the sizes of the buckets that are not full
    rows_at: int


def read_ksplat(stream: SeekableReader) -> GaussianCloud:
    """Read all sections as one cloud.

    Raises:
        FormatError: an unknown version or level, sections that do not fit into the file or their buckets.
        InputError: a rotation that is none, too many Gaussians.
    """
    range = 1.5  # of harmonics of 8 bits, where the header does not say
    content = stream.read(remaining_bytes(stream))
    if len(content) < _HEADER_BYTES:
        raise FormatError(f"the .ksplat file has {len(content):,} bytes; its header alone has {_HEADER_BYTES:,}")
    major, minor, num_sections, _, _, count, level, least, most = _HEADER.unpack_from(content)
    if (major, minor) != (0, 1) or level not in _PLACE_BYTES:
        raise FormatError(
            f"the .ksplat file is of version {major}.{minor} and compression level {level}; version 0.1 and the "
            "levels 0, 1 and 2 are understood"
        )
    check_count(count)
    if _HEADER_BYTES + num_sections * _SECTION_BYTES > len(content):
        raise FormatError(f"the .ksplat file names {num_sections:,} sections, more than fit into it; it is truncated")
    sections = [section for section in _sections(content, num_sections, level) if section.count]
    if sum(section.count for section in sections) != count:
        present = sum(section.count for section in sections)
        raise FormatError(f"the .ksplat file says {count:,} Gaussians, its sections have {present:,}")
    bounds = (least or -range, most or range)
    if not max(map(abs, bounds)) <= _FARTHEST:
        raise FormatError(
            f"harmonics of the .ksplat file lie between {bounds[0]:g} and {bounds[1]:g}, which is no range"
        )
    return joined([_read_section(content, section, level, bounds) for section in sections])


def _sections(content: bytes, num_sections: int, level: int) -> Iterator[_Section]:
    usual_steps = 32_767  # to either side of a bucket's middle, where the section does not say
    place = _HEADER_BYTES + num_sections * _SECTION_BYTES
    for number in range(num_sections):
        header = _SECTION.unpack_from(content, _HEADER_BYTES + number * _SECTION_BYTES)
        count, room, per_bucket, num_buckets, block_m, bucket_bytes, steps, num_full, num_partial, degree = header
        contradicts = degree > 2 or count > room or num_full + num_partial > num_buckets
        if contradicts or (num_buckets and bucket_bytes < 12) or not 0 <= block_m <= _FARTHEST:
            raise FormatError(
                f"section {number} of the .ksplat file contradicts itself: {count:,} Gaussians in room for {room:,}, "
                f"{num_full:,} full and {num_partial:,} other of {num_buckets:,} buckets of "
                f"{block_m:g}, harmonics of degree {degree}"
            )
        buckets_at = place + 4 * num_partial
        rows_at = buckets_at + bucket_bytes * num_buckets
        place = rows_at + room * _row(level, degree).itemsize
        if place > len(content):
            raise FormatError(f"section {number} of the .ksplat file ends at {place:,} of {len(content):,} bytes")
        yield _Section(
            count=count,
            per_bucket=per_bucket,
            num_buckets=num_buckets,
            num_full=num_full,
            num_partial=num_partial,
            block_m=block_m,
            steps=steps or usual_steps,
            degree=degree,
            buckets_at=buckets_at,
            rows_at=rows_at,
        )


def _row(level: int, degree: int) -> np.dtype[np.void]:
    place, size, harmonic = _PLACE_BYTES[level]
    num_rest = 3 * ((degree + 1) ** 2 - 1)
    fields = [("mean", place, 3), ("scale", size, 3), ("rotation", size, 4), ("rgba", "u1", 4)]
    return np.dtype([*fields, ("rest", harmonic, num_rest)])


def _read_section(content: bytes, section: _Section, level: int, bounds: tuple[float, float]) -> GaussianCloud:
    rows = np.frombuffer(content, _row(level, section.degree), section.count, section.rows_at)
    means = rows["mean"].astype(np.float32)
    if level:
        step = np.float32(section.block_m / 2 / section.steps)
        means = (means - section.steps) * step + _bucket_middles(content, section)
    rest = rows["rest"].astype(np.float32)
    if level == 2:
        rest = bounds[0] + rest / np.float32(255) * (bounds[1] - bounds[0])
    sh = np.zeros((section.count, (section.degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = harmonic_from_color(rows["rgba"][:, :3] / np.float32(255))
    for band in range(1, section.degree + 1):  # a band after another, in each all of red, then green, then blue
        own = rest[:, 3 * (band**2 - 1) : 3 * ((band + 1) ** 2 - 1)]
        sh[:, band**2 : (band + 1) ** 2] = own.reshape(section.count, 3, -1).transpose(0, 2, 1)
    return GaussianCloud(
        means=means.astype(np.float32),
        quaternions=unit_quaternions(rows["rotation"].astype(np.float32)),
        scales=rows["scale"].astype(np.float32),
        opacity=rows["rgba"][:, 3] / np.float32(255),
        sh=sh,
    )


def _bucket_middles(content: bytes, section: _Section) -> Float32[np.ndarray, "G 3"]:
    """The middle of the bucket of each Gaussian: first the full buckets, then the others with their own sizes."""
    partial = np.frombuffer(content, "<u4", section.num_partial, section.buckets_at - 4 * section.num_partial)
    sizes = np.concatenate([np.full(section.num_full, section.per_bucket), partial.astype(np.int64)])
    if sizes.sum() != section.count:
        raise FormatError(
            f"the buckets of a .ksplat section hold {int(sizes.sum()):,} Gaussians; {section.count:,} are there"
        )
    width = (section.rows_at - section.buckets_at) // section.num_buckets
    middles = np.frombuffer(content, np.dtype((np.void, width)), section.num_buckets, section.buckets_at)
    places = np.ascontiguousarray(middles.view(np.uint8).reshape(-1, width)[:, :12]).view("<f4")
    return places[np.repeat(np.arange(len(sizes)), sizes)[: section.count]].astype(np.float32)
