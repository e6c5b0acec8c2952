""".splat: 32 bytes per Gaussian, no header. Position 3 × f32, scale 3 × f32, RGBA 4 × u8, rotation wxyz 4 × u8."""

import numpy as np

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import FormatError
from dynamictree.formats.seekable import SeekableReader, remaining_bytes
from dynamictree.formats.splat.activations import color_from_harmonic, harmonic_from_color
from dynamictree.gaussian.axes import to_source_axes
from dynamictree.gaussian.cloud import GaussianCloud, check_count
from dynamictree.rotation import unit_quaternions

UP_AXIS = "-Y"
_RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])


def read_splat(stream: SeekableReader) -> GaussianCloud:
    """Read a cloud of degree 0.

    Raises:
        FormatError: the size is not a multiple of 32 bytes.
        InputError: a rotation of length zero, too many Gaussians.
    """
    size = remaining_bytes(stream)
    if size % _RECORD.itemsize:
        raise FormatError(
            f"the .splat file is {size:,} bytes; a whole number of {_RECORD.itemsize}-byte records is needed"
        )
    check_count(size // _RECORD.itemsize)
    rows = np.frombuffer(stream.read(size), _RECORD)
    sound = np.isfinite(rows["mean"]).all(axis=1) & np.isfinite(rows["scale"]).all(axis=1)
    rows = rows[sound] if sound.any() else rows
    color = rows["rgba"][:, :3] / np.float32(255)
    return GaussianCloud(
        means=rows["mean"].astype(np.float32),
        quaternions=unit_quaternions((rows["rotation"].astype(np.float32) - 128) / 128),
        scales=rows["scale"].astype(np.float32),
        opacity=rows["rgba"][:, 3].astype(np.float32) / np.float32(255),
        sh=harmonic_from_color(color)[:, None],
        dropped=len(sound) - len(rows),
    )


def write_splat(cloud: GaussianCloud, stream: ByteWriter) -> None:
    """Write a cloud in the source's axes and units; colour, opacity and rotation become bytes, degree 0 remains."""
    source = to_source_axes(cloud.with_sh_degree(0))
    rows = np.empty(source.num_gaussians, _RECORD)
    rows["mean"], rows["scale"] = source.means, source.scales
    rows["rgba"][:, :3] = np.clip(np.rint(color_from_harmonic(source.sh[:, 0]) * 255), 0, 255)
    rows["rgba"][:, 3] = np.clip(np.rint(source.opacity * 255), 0, 255)
    rows["rotation"] = np.clip(np.rint(source.quaternions * 128 + 128), 0, 255)
    stream.write(rows.tobytes())
