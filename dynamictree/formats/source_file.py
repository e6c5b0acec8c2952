"""Read any input shape: a mesh, or a cloud with an optional mask and mesh."""

from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from typing import Literal

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them

from dynamictree.axis_names import name_of
from dynamictree.errors import FormatError
from dynamictree.formats.cloud_file import CLOUD_TYPES, SPLAT_TYPES, cloud_kind, read_cloud, says_unit, says_up_axis
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.formats.origin import offset_warnings
from dynamictree.formats.seekable import SeekableReader
from dynamictree.formats.splat.mask import read_mask
from dynamictree.formats.splat.sog import bundled, is_folder_file
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import SourceWarning
from dynamictree.plant.axes import axis_doubts
from dynamictree.plant.capture import Capture, moving_part, with_still_parts
from dynamictree.plant.cloud_size import sized
from dynamictree.plant.level import up_of_standing
from dynamictree.plant.still_gaussians import touching_groups
from dynamictree.plant.trees.choose import several_trees
from dynamictree.plant.trees.segment import segment_trees
from dynamictree.plant.upright import judge_up_axis_of_points
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation

SourceKind = Literal["mesh", "cloud"]
HEAD_BYTES = 64 * 1024
FEWEST_GAUSSIANS = 500
"""Of a splat that can look like a plant."""
_VISIBLE = 0.1  # opacity of Gaussians that show the shape
_GAP, _SOME = 4.0, 5_000
"""Gaps beside which Gaussians are specks, in their middle axis' standard deviation; and how many are looked at."""
_CELL, _TOGETHER = 0.03, 0.5
"""Of the height: what is so near hangs together; and the least share of a plant that does."""
_FLAT = 0.25  # height over width of what does not stand upright


def source_kind(stream: SeekableReader, name: str) -> tuple[SourceKind, str]:
    """Whether a file is a mesh or a cloud, and its type for the readers; the stream is left at its start.

    Raises:
        FormatError: it is neither, or a header breaks its format's rules.
    """
    ending = name.rpartition(".")[2].lower()
    if ending in SPLAT_TYPES:
        return "cloud", ending
    stream.seek(0)
    head = stream.read(HEAD_BYTES)
    if head.lstrip().startswith(b"{") and all(word in head for word in (b'"means"', b'"quats"', b'"scales"')):
        return "cloud", "sog"
    file_type = sniff_file_type(head, name)
    stream.seek(0)
    if file_type in ("points", "las", "pcd"):
        return "cloud", "txt" if file_type == "points" else file_type
    if file_type in ("ply", "glb") and cloud_kind(stream, file_type=file_type) != "mesh":
        return "cloud", file_type
    return "mesh", file_type


def read_capture(
    stream: SeekableReader,
    *,
    file_type: str,
    reading: Reading | None = None,
    mask: SeekableReader | None = None,
    mesh: tuple[str, SeekableReader] | None = None,
    companions: Mapping[str, bytes] | None = None,
) -> Capture:
    """Read a cloud and what came with it, in metres and +Z up.

    Args:
        stream: the cloud's file, at its start.
        file_type: such as `source_kind` gives.
        reading: the file's axis and unit; if unset its format's habit and, for scans, 1 m. A splat of unknown axes
            is levelled, one of unknown unit made 5 m tall.
        mask: which Gaussians may move (`names.MASK_NAME`).
        mesh: name and content of a mesh that lies where the cloud lies, in the same axes and units.
        companions: files that the mesh, or the `meta.json` of a SOG folder, may name.

    Raises:
        InputError: one of the files cannot be read, or they do not fit together.
    """
    assert file_type in CLOUD_TYPES
    reading = reading or Reading()
    stated = reading.unit_m is not None or says_unit(stream, file_type=file_type)
    if file_type == "sog" and is_folder_file(stream):
        stream = bundled(stream, companions or {})
    as_it_is, levelled = _upright(stream, file_type, reading)
    cloud, doubts = sized(as_it_is, height_m=reading.height_m, stated=stated)
    doubts += levelled + offset_warnings(cloud.source_offset) + _remarks(cloud, file_type, reading)
    capture = with_still_parts(Capture(cloud=cloud, mask=None if mask is None else read_mask(mask), warnings=doubts))
    sides = () if reading.up_axis else _doubt_axis(capture)
    capture = replace(capture, warnings=(*doubts, *sides, *_doubt_plant(capture)))
    if mesh is None:
        return _with_trees(capture, is_scan=cloud_kind(stream, file_type=file_type) == "points")
    name, content = mesh
    kind, mesh_type = source_kind(content, name)
    if kind != "mesh":
        raise FormatError(
            f"{name!r} is a cloud, and so is the file beside it; send one cloud, and a mesh if you have one"
        )
    beside = read_mesh(
        BytesIO(content.read()),
        file_type=mesh_type,
        reading=Reading(up_axis=cloud.source_up_axis, unit_m=cloud.source_scale),
        companions=companions,
    )
    apart = np.subtract(beside.source_offset, cloud.source_offset)  # each file was moved to the origin by itself
    moved = beside.vertices + (up_rotation(cloud.source_up_axis) @ apart * cloud.source_scale)
    return replace(
        capture,
        mesh=replace(beside, vertices=moved.astype(np.float32), source_offset=cloud.source_offset),
    )


def _remarks(cloud: GaussianCloud, file_type: str, reading: Reading) -> tuple[SourceWarning, ...]:
    """What was left out of a cloud, and the unit that a scan says itself."""
    remarks = []
    if cloud.dropped:
        message = f"{cloud.dropped:,} rows that are not finite, or that the file marks as noise, were left out"
        remarks.append(SourceWarning(code="rows-left-out", message=message))
    if file_type in ("las", "laz") and cloud.source_scale != 1 and reading.unit_m is None and not reading.height_m:
        message = (
            f"the scan's coordinate system is in units of {cloud.source_scale:.7g} m, which became metres; set unit_m "
            "to 1 if its numbers are metres all the same"
        )
        remarks.append(SourceWarning(code="unit-of-the-file", message=message))
    return tuple(remarks)


def _upright(
    stream: SeekableReader, file_type: str, reading: Reading
) -> tuple[GaussianCloud, tuple[SourceWarning, ...]]:
    """Read a cloud; a splat of unknown axes is turned until what it stands on is level, which a warning says."""
    up_axis, unit_m = reading.up_axis, reading.unit_m
    stated = up_axis is not None or says_up_axis(stream, file_type=file_type)
    cloud = read_cloud(stream, file_type=file_type, up_axis=up_axis, unit_m=unit_m)
    up = None if stated else up_of_standing(cloud.means[cloud.opacity >= _VISIBLE].astype(np.float64))
    if up is None:
        return cloud, ()
    usual, level = cloud.source_up_axis, name_of((up_rotation(cloud.source_up_axis).T @ up).tolist())
    stream.seek(0)
    tilt_deg = np.degrees(np.arccos(up[2]))
    message = (
        f"what the plant stands on is {tilt_deg:.0f}° from level if {usual} is up, so {level} was taken as up; "
        f"set up_axis to {usual} if the plant stood upright before"
    )
    return read_cloud(stream, file_type=file_type, up_axis=level, unit_m=unit_m), (
        SourceWarning(code="levelled", message=message),
    )


def _with_trees(capture: Capture, *, is_scan: bool) -> Capture:
    """Separate the trees of a capture if there are several.

    Raises:
        InputError: a scan of more than one tree shows no stems.
    """
    moving = np.flatnonzero(moving_part(capture))
    segmentation = segment_trees(capture.cloud.means[moving].astype(np.float64), is_scan=is_scan)
    if len(segmentation.trees) == 1:
        return capture
    tree = np.full(capture.cloud.num_gaussians, -1, np.int32)
    tree[moving] = segmentation.tree_of_point
    return replace(capture, tree=tree, warnings=(*capture.warnings, several_trees(len(segmentation.trees))))


def _doubt_axis(capture: Capture) -> tuple[SourceWarning, ...]:
    """A warning if the shape of what moves stands upright along another axis than that of the file's format."""
    points = capture.cloud.means[moving_part(capture) & (capture.cloud.opacity >= _VISIBLE)]
    judged = judge_up_axis_of_points(points) if len(points) >= FEWEST_GAUSSIANS else None
    return axis_doubts(judged, capture.cloud.source_up_axis)


def _doubt_plant(capture: Capture) -> tuple[SourceWarning, ...]:
    """A warning if what moves is too little for a plant, or lies flat."""
    points = capture.cloud.means[moving_part(capture)]
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    width, height = float((high - low)[:2].max()), float((high - low)[2])
    if len(points) < FEWEST_GAUSSIANS:
        message = f"{len(points):,} Gaussians or points can hardly show a plant; usual are 10,000 and more"
    elif height < _FLAT * width:
        message = (
            f"what moves is {height:.3g} m tall and {width:.3g} m wide, so nothing stands upright; "
            "set up_axis if it lies, or box_m to the plant if it is in a scene"
        )
    elif (together := _share_together(capture.cloud.subset(moving_part(capture)), height)) < _TOGETHER:
        message = (
            f"what moves are specks far from each other, of which {together:.0%} hang together; those of a plant "
            "touch: send the splat as it was before it was thinned out"
        )
    else:
        return ()
    return (SourceWarning(code="not-like-a-plant", message=message),)


def _share_together(cloud: GaussianCloud, height_m: float) -> float:
    """Share of the visible Gaussians in the largest group where they are small beside their gaps, else 1."""
    cloud = cloud.subset(cloud.opacity >= _VISIBLE)
    if cloud.num_gaussians < 2:
        return 1.0
    points = cloud.means.astype(np.float64)
    some = np.random.default_rng(0).permutation(len(points))[:_SOME]
    gap = np.asarray(scipy.spatial.cKDTree(points).query(points[some], k=2)[0])[:, 1]
    if np.median(gap) < _GAP * np.median(np.sort(cloud.scales[some], axis=1)[:, 1]):
        return 1.0
    _, _, count, group = touching_groups(points, _CELL * height_m)
    return float(np.bincount(group, count).max() / len(points))
