"""Builds .ksplat files, which nothing of ours writes; splat-transform reads what this writes."""

import struct

import numpy as np

from dynamictree.formats.splat.activations import color_from_harmonic
from dynamictree.gaussian.cloud import GaussianCloud

PER_BUCKET = 64
BLOCK_M = 5.0
RANGE = (-1.0, 1.0)


def ksplat_bytes(cloud: GaussianCloud, level: int, *, num_sections: int = 2) -> bytes:
    """The cloud in sections of equal size, in buckets of 64 in its order, the last one of a section not full."""
    parts = [
        _section(cloud.subset(rows), level) for rows in np.array_split(np.arange(cloud.num_gaussians), num_sections)
    ]
    header = struct.pack("<BBxxIIII", 0, 1, num_sections, num_sections, cloud.num_gaussians, cloud.num_gaussians)
    header += struct.pack("<Hxx12xff", level, *RANGE)
    return header.ljust(4096, b"\0") + b"".join(head for head, _ in parts) + b"".join(body for _, body in parts)


def _section(cloud: GaussianCloud, level: int) -> tuple[bytes, bytes]:
    count, steps = cloud.num_gaussians, 32_767
    bucket = np.arange(count) // PER_BUCKET
    num_full, left = divmod(count, PER_BUCKET)
    low = np.array([cloud.means[bucket == b].min(axis=0) for b in range(bucket[-1] + 1)])
    middles = low + BLOCK_M / 2
    head = struct.pack("<IIIIfHxxIII", count, count, PER_BUCKET, len(middles), BLOCK_M, 12, steps, 0, num_full)
    head += struct.pack("<IH", 1 if left else 0, cloud.sh_degree)
    body = [struct.pack("<I", left) if left else b"", middles.astype("<f4").tobytes()]
    small = "<f4" if level == 0 else "<f2"
    places = cloud.means if level == 0 else np.rint((cloud.means - middles[bucket]) / (BLOCK_M / 2 / steps) + steps)
    rgba = np.concatenate([color_from_harmonic(cloud.sh[:, 0]), cloud.opacity[:, None]], axis=1)
    bands = [
        cloud.sh[:, d * d : (d + 1) ** 2].transpose(0, 2, 1).reshape(count, -1) for d in range(1, cloud.sh_degree + 1)
    ]
    rest = np.concatenate([np.empty((count, 0)), *bands], axis=1)
    if level == 2:
        rest = np.clip(np.rint((rest - RANGE[0]) / (RANGE[1] - RANGE[0]) * 255), 0, 255)
    columns = [
        places.astype("<f4" if level == 0 else "<u2"),
        cloud.scales.astype(small),
        cloud.quaternions.astype(small),
        np.clip(np.rint(rgba * 255), 0, 255).astype("u1"),
        rest.astype("u1" if level == 2 else small),
    ]
    rows = [np.ascontiguousarray(column).view("u1").reshape(count, -1) for column in columns if column.shape[1]]
    return head.ljust(1024, b"\0"), b"".join(body) + np.concatenate(rows, axis=1).tobytes()
