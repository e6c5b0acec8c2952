"""3DGS PLY files, as Kerbl et al. 2023 wrote them: read by property name in any order, with SH degree 0 to 3."""

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Shaped
from scipy.special import expit

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import FormatError
from dynamictree.formats.ply_table import axis_comments, read_elements, read_header
from dynamictree.formats.seekable import SeekableReader
from dynamictree.formats.splat.activations import (
    MIN_SCALE,
    harmonic_from_color,
    log_from_scales,
    logit_from_opacity,
    scales_from_log,
)
from dynamictree.gaussian.axes import to_source_axes
from dynamictree.gaussian.cloud import GaussianCloud, check_count
from dynamictree.rotation import unit_quaternions

UP_AXIS = "-Y"
"""Scenes reconstructed from photos have y downward, as their first camera has."""
_NORMALS = ("nx", "ny", "nz")
_POSITION = ("x", "y", "z")
_COLOR = ("f_dc_0", "f_dc_1", "f_dc_2")
_BYTE_COLOR = ("red", "green", "blue")  # colours in place of harmonics, an option of nerfstudio's export
_SCALE = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
REQUIRED = (*_POSITION, *_COLOR, "opacity", *_SCALE, *_ROTATION)


def read_gaussian_ply(stream: SeekableReader) -> GaussianCloud:
    """Read a trained splat.

    Raises:
        FormatError: not a PLY file, properties missing (they are named), or shorter than its header says.
        InputError: a rotation of length zero, too many Gaussians.
    """
    header = read_header(stream)
    vertex = header.element("vertex")
    names = vertex.names if vertex else frozenset[str]()
    color = _COLOR if names.issuperset(_COLOR) or not names.issuperset(_BYTE_COLOR) else _BYTE_COLOR
    missing = [name for name in REQUIRED if name not in names | {"scale_2"} | (set(_COLOR) - set(color))]
    if vertex is None or missing:
        raise FormatError(f"the PLY file is no Gaussian splat: its vertices have no {', '.join(missing)}")
    check_count(vertex.count)
    rest = rest_names(names)
    (rows,) = read_elements(stream, header, "vertex")
    rows, dropped = _valid_rows(rows)
    scales = _columns(rows, _SCALE if "scale_2" in (rows.dtype.names or ()) else _SCALE[:2])
    if scales.shape[1] == 2:  # 2D Gaussian splatting (Huang et al. 2024) stores two per disc, the third is flat
        scales = np.pad(scales, ((0, 0), (0, 1)), constant_values=np.float32(np.log(MIN_SCALE)))
    num_rest = len(rest) // 3
    sh = np.empty((len(rows), 1 + num_rest, 3), np.float32)
    stored = _columns(rows, color)
    sh[:, 0] = stored if color == _COLOR else harmonic_from_color(stored / np.float32(255))
    # channel-major: all of red, then green, then blue
    for index, name in enumerate(rest):
        sh[:, 1 + index % num_rest, index // num_rest] = rows[name]
    return GaussianCloud(
        means=_columns(rows, _POSITION),
        quaternions=unit_quaternions(_columns(rows, _ROTATION)),
        scales=scales_from_log(scales),
        opacity=expit(rows["opacity"].astype(np.float32)),
        sh=sh,
        dropped=dropped,
    )


def _valid_rows(rows: Shaped[np.ndarray, " G"]) -> tuple[Shaped[np.ndarray, " M"], int]:
    """Drop rows that are not finite or have no rotation, which training can leave; drop none if all are such."""
    sound = (_columns(rows, _ROTATION) != 0).any(axis=1)
    for name in rows.dtype.names or ():
        sound &= np.isfinite(rows[name])
    return (rows[sound], int((~sound).sum())) if sound.any() else (rows, 0)


def write_gaussian_ply(cloud: GaussianCloud, stream: ByteWriter) -> None:
    """Write a file for any splat viewer, in the source's axes and units; `read_gaussian_ply` is the inverse."""
    comments = axis_comments(cloud.source.up_axis, cloud.source.scale, cloud.source.offset)
    stream.write(ply_header(cloud.num_gaussians, cloud.sh.shape[1], comments=comments))
    stream.write(ply_rows(to_source_axes(cloud)).tobytes())


def ply_header(num_gaussians: int, num_harmonics: int, *, comments: Sequence[str] = ()) -> bytes:
    """Return the header of a file with the body `ply_rows`."""
    lines = ["ply", "format binary_little_endian 1.0", *comments, f"element vertex {num_gaussians}"]
    lines += [f"property float {name}" for name in property_names(num_harmonics)]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def property_names(num_harmonics: int) -> list[str]:
    """Return the property names in the order of Kerbl et al."""
    rest = [f"f_rest_{i}" for i in range(3 * (num_harmonics - 1))]
    return [*_POSITION, *_NORMALS, *_COLOR, *rest, "opacity", *_SCALE, *_ROTATION]


def ply_rows(cloud: GaussianCloud) -> Float32[np.ndarray, "G P"]:
    """Return the body of a file, for a cloud in the file's axes and units. Normals are 0, as in Kerbl et al."""
    num_rest = cloud.sh.shape[1] - 1
    rows = np.zeros((cloud.num_gaussians, 17 + 3 * num_rest), "<f4")
    rows[:, 0:3] = cloud.means
    rows[:, 6:9] = cloud.sh[:, 0]
    rows[:, 9:-8] = cloud.sh[:, 1:].transpose(0, 2, 1).reshape(len(rows), -1)  # all of red, then green, then blue
    rows[:, -8] = logit_from_opacity(cloud.opacity)
    rows[:, -7:-4] = log_from_scales(cloud.scales)
    rows[:, -4:] = cloud.quaternions
    return rows


def rest_names(names: frozenset[str]) -> list[str]:
    """Return the names f_rest_0, f_rest_1, … in order.

    Raises:
        FormatError: their number does not match an SH degree from 0 to 3.
    """
    count = sum(1 for name in names if re.fullmatch(r"f_rest_\d+", name))
    rest = [f"f_rest_{i}" for i in range(count)]
    if count not in (0, 9, 24, 45) or not names.issuperset(rest):
        raise FormatError(f"the splat has {count} properties f_rest_*; 0, 9, 24 or 45, numbered from 0, are allowed")
    return rest


def _columns(rows: Shaped[np.ndarray, " G"], names: tuple[str, ...]) -> Float32[np.ndarray, "G columns"]:
    return np.stack([rows[name].astype(np.float32) for name in names], axis=1)
