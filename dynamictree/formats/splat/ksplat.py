""".ksplat files of GaussianSplats3D, version 0.1: sections of Gaussians, with positions quantised in buckets.

Compression level 0 stores floats, level 1 half floats and 16-bit positions, level 2 the same with 8-bit harmonics.
"""

import struct
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.formats.splat.activations import harmonic_from_color
from dynamictree.gaussian.cloud import GaussianCloud, check_count, join_clouds
from dynamictree.rotation import unit_quaternions

UP_AXIS = "-Y"
_HEADER = struct.Struct("<BBxxIIIIHxx12xff")
_HEADER_BYTES = 4096
_SECTION = struct.Struct("<IIIIfHxxI4xIIH")
_SECTION_BYTES = 1024
_PLACE_BYTES = {0: ("<f4", "<f4", "<f4"), 1: ("<u2", "<f2", "<f2"), 2: ("<u2", "<f2", "u1")}
"""Types of positions, of scales and rotations, and of harmonics, by compression level."""
_FARTHEST = 1e6  # limit of a bucket's size and of 8-bit harmonics


class _Section(NamedTuple):
    """One section's header, in the file's order."""

    num_rows: int
    room: int  # Gaussians that the file has bytes for
    per_bucket: int
    num_buckets: int
    block_m: float
    bucket_bytes: int
    steps: int
    num_full: int
    num_partial: int
    degree: int


class _Place(NamedTuple):
    """Offsets of the parts of a section in the file [bytes]."""

    buckets: int  # bucket middles, which follow the sizes of the partial buckets
    rows: int


def read_ksplat(stream: SeekableReader) -> GaussianCloud:
    """Read all sections as one cloud.

    Raises:
        FormatError: an unknown version or level, sections that do not fit into the file or their buckets.
        InputError: a rotation of length zero, too many Gaussians.
    """
    range = 1.5  # default limit of 8-bit harmonics
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
    sections = [(section, place) for section, place in _sections(content, num_sections, level) if section.num_rows]
    present = sum(section.num_rows for section, _ in sections)
    if present != count:
        raise FormatError(f"the .ksplat file says {count:,} Gaussians, its sections have {present:,}")
    bounds = (least or -range, most or range)
    if not max(map(abs, bounds)) <= _FARTHEST:
        raise FormatError(
            f"harmonics of the .ksplat file lie between {bounds[0]:g} and {bounds[1]:g}, which is no range"
        )
    return join_clouds([_read_section(content, section, place, level, bounds) for section, place in sections])


def _sections(content: bytes, num_sections: int, level: int) -> Iterator[tuple[_Section, _Place]]:
    end = _HEADER_BYTES + num_sections * _SECTION_BYTES
    for number in range(num_sections):
        one = _Section._make(_SECTION.unpack_from(content, _HEADER_BYTES + number * _SECTION_BYTES))
        contradicts = one.degree > 2 or one.num_rows > one.room or one.num_full + one.num_partial > one.num_buckets
        if contradicts or (one.num_buckets and one.bucket_bytes < 12) or not 0 <= one.block_m <= _FARTHEST:
            raise FormatError(
                f"section {number} of the .ksplat file contradicts itself: {one.num_rows:,} Gaussians in room for "
                f"{one.room:,}, {one.num_full:,} full and {one.num_partial:,} other of {one.num_buckets:,} buckets of "
                f"{one.block_m:g}, harmonics of degree {one.degree}"
            )
        buckets = end + 4 * one.num_partial
        rows = buckets + one.bucket_bytes * one.num_buckets
        end = rows + one.room * _row(level, one.degree).itemsize
        if end > len(content):
            raise FormatError(f"section {number} of the .ksplat file ends at {end:,} of {len(content):,} bytes")
        yield one, _Place(buckets, rows)


def _row(level: int, degree: int) -> np.dtype[np.void]:
    place, size, harmonic = _PLACE_BYTES[level]
    num_rest = 3 * ((degree + 1) ** 2 - 1)
    fields = [("mean", place, 3), ("scale", size, 3), ("rotation", size, 4), ("rgba", "u1", 4)]
    return np.dtype([*fields, ("rest", harmonic, num_rest)])


def _read_section(
    content: bytes, section: _Section, place: _Place, level: int, bounds: tuple[float, float]
) -> GaussianCloud:
    usual_steps = 32_767  # default number of steps to either side of a bucket's middle
    rows = np.frombuffer(content, _row(level, section.degree), section.num_rows, place.rows)
    means = rows["mean"].astype(np.float32)
    if level:
        steps = section.steps or usual_steps
        means = (means - steps) * np.float32(section.block_m / 2 / steps) + _bucket_middles(content, section, place)
    rest = rows["rest"].astype(np.float32)
    if level == 2:
        rest = bounds[0] + rest / np.float32(255) * (bounds[1] - bounds[0])
    sh = np.zeros((section.num_rows, (section.degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = harmonic_from_color(rows["rgba"][:, :3] / np.float32(255))
    for band in range(1, section.degree + 1):  # bands in order; in each all of red, then green, then blue
        own = rest[:, 3 * (band**2 - 1) : 3 * ((band + 1) ** 2 - 1)]
        sh[:, band**2 : (band + 1) ** 2] = own.reshape(section.num_rows, 3, -1).transpose(0, 2, 1)
    return GaussianCloud(
        means=means.astype(np.float32),
        quaternions=unit_quaternions(rows["rotation"].astype(np.float32)),
        scales=rows["scale"].astype(np.float32),
        opacity=rows["rgba"][:, 3] / np.float32(255),
        sh=sh,
    )


def _bucket_middles(content: bytes, section: _Section, place: _Place) -> Float32[np.ndarray, "G 3"]:
    """Return the middle of each Gaussian's bucket: full buckets come first, then partial ones with their sizes."""
    partial = np.frombuffer(content, "<u4", section.num_partial, place.buckets - 4 * section.num_partial)
    sizes = np.concatenate([np.full(section.num_full, section.per_bucket), partial.astype(np.int64)])
    if sizes.sum() != section.num_rows:
        raise FormatError(
            f"the buckets of a .ksplat section hold {int(sizes.sum()):,} Gaussians; {section.num_rows:,} are there"
        )
    width = section.bucket_bytes
    middles = np.frombuffer(content, np.dtype((np.void, width)), section.num_buckets, place.buckets)
    places = np.ascontiguousarray(middles.view(np.uint8).reshape(-1, width)[:, :12]).view("<f4")
    return places[np.repeat(np.arange(len(sizes)), sizes)[: section.num_rows]].astype(np.float32)
