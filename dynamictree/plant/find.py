"""Find the plant in a file's mesh or cloud: upright, in metres, with still parts and trees separated."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool

from dynamictree.axis_names import name_of
from dynamictree.gaussian.axes import to_source_axes, to_z_up
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import SourceWarning, TriangleMesh, validate_mesh
from dynamictree.plant.axes_unit import Conventions, axis_doubts, crown_warnings, mesh_to_z_up, scale_cloud, size_doubts
from dynamictree.plant.capture import Capture, moving_part, with_still_parts
from dynamictree.plant.plausibility import FEWEST_FACES, VISIBLE, doubt_cloud, doubt_mesh
from dynamictree.plant.splat_up import up_of_standing
from dynamictree.plant.still_cloud import find_sky
from dynamictree.plant.still_mesh import find_still_parts
from dynamictree.plant.trees.of_mesh import feet_are_level, with_trees
from dynamictree.plant.trees.segment import segment_trees, several_trees
from dynamictree.plant.upright import SURE_OF_POINTS, judge_each_standing, judge_standing, judge_up_axis_of_points
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation


def plant_of_mesh(source: TriangleMesh, reading: Reading, file: Conventions) -> TriangleMesh:
    """Find the plant in a mesh in its file's axes and unit.

    Raises:
        InputError: the method cannot work on the mesh.
    """
    upright = validate_mesh(mesh_to_z_up(source, reading, file))
    parts, still = find_still_parts(upright)
    mesh = replace(upright, parts=replace(upright.parts, still=parts), still_faces=still)
    mesh = with_trees(replace(mesh, warnings=mesh.warnings + doubt_mesh(mesh)))
    if reading.up_axis is None and file.up_axis is not None and mesh.num_faces >= FEWEST_FACES:
        standing = judge_each_standing(mesh.moving_part) or judge_standing(mesh.moving_part)
        if standing and feet_are_level(mesh, standing.axis):
            mesh = replace(mesh, warnings=mesh.warnings + axis_doubts(standing, mesh.source.up_axis))
    if reading.unit_m is None and reading.height_m is None and mesh.face_tree is None:
        sizes = size_doubts(mesh, file_unit=file.unit_m is not None)
        mesh = replace(mesh, warnings=mesh.warnings + sizes)
    return mesh


@dataclass(frozen=True, kw_only=True)
class CloudFacts:
    """Metadata of a cloud's file."""

    origin: Literal["scan", "photos", "splat"]  # only scans have a reliable up axis and unit
    says_axis: bool = False
    says_unit: bool = False


def plant_of_cloud(
    cloud: GaussianCloud,
    reading: Reading,
    file: CloudFacts,
    *,
    mask: Bool[np.ndarray, " G"] | None = None,  # Gaussians that may move, if known
    tell_trees: bool = True,
) -> Capture:
    """Find the plant in a splat or scan that was converted to metres and +Z up by the request, file or format.

    Raises:
        InputError: a scan of several trees shows no stems, or the mask has another length.
    """
    turned: tuple[SourceWarning, ...] = ()
    if not (reading.up_axis or file.says_axis):
        cloud, turned = _upright(cloud, by_shape=file.origin == "photos")
    stated = reading.unit_m is not None or file.says_unit
    cloud, sizes = scale_cloud(cloud, height_m=reading.height_m, stated=stated, keep=file.origin == "photos")
    capture = with_still_parts(Capture(cloud=cloud, mask=mask, warnings=sizes + turned))
    doubts = doubt_cloud(cloud.subset(moving_part(capture)))
    capture = _with_trees(capture, is_scan=file.origin == "scan") if tell_trees else capture
    axis = () if reading.up_axis else _doubt_axis(capture)
    general = turned if axis and turned and turned[0].code == axis[0].code else ()  # replaced by `axis`
    return replace(capture, warnings=tuple(one for one in capture.warnings if one not in general) + doubts + axis)


def _upright(cloud: GaussianCloud, *, by_shape: bool) -> tuple[GaussianCloud, tuple[SourceWarning, ...]]:
    """Rotate a cloud so that its ground is level, with `by_shape` first by its likeliest up axis; add a warning."""
    usual, seen = cloud.source.up_axis, (cloud.opacity >= VISIBLE) & ~find_sky(cloud)
    judged = judge_up_axis_of_points(cloud.means[seen & by_shape])
    sure = judged.confidence >= SURE_OF_POINTS
    shape = sure and judged.axis != "+Z"
    way = up_rotation(judged.axis) if shape else np.eye(3)
    level = up_of_standing(cloud.means[seen].astype(np.float64) @ way.T)
    if level is None and not shape:
        message = f"points made from photos do not say which way is up; {usual} was taken; set up_axis if it is another"
        return cloud, (SourceWarning(code="orientation-uncertain", message=message),) if by_shape and not sure else ()
    up = way.T @ (np.array([0.0, 0.0, 1.0]) if level is None else level)
    name = name_of((up_rotation(usual).T @ up).tolist())
    tilt_deg = np.degrees(np.arccos(np.clip(up[2], -1, 1)))
    message = (
        f"{'the plant' if level is None else 'what the plant stands on'} is {tilt_deg:.0f}° from level if {usual} is "
        f"up, so {name} was taken as up; set up_axis to {usual} if the plant stood upright before"
    )
    turned = to_z_up(to_source_axes(cloud), up_axis=name, unit_m=cloud.source.scale)
    return turned, (SourceWarning(code="levelled", message=message),)


def _doubt_axis(capture: Capture) -> tuple[SourceWarning, ...]:
    """Warn if the moving part stands along another axis than the assumed one, or a single plant rather lies."""
    lies, widest = 0.75, 2.0  # 117 standing plants have 0.69 at most; [height], since plots and hedges are wider
    points = capture.cloud.means[moving_part(capture) & (capture.cloud.opacity >= VISIBLE)]
    judged, taken = judge_up_axis_of_points(points), capture.cloud.source.up_axis
    if judged.confidence >= SURE_OF_POINTS:
        return axis_doubts(judged, taken)
    one = capture.tree is None and judged.lying >= lies
    lying = one and np.ptp(points[:, :2], axis=0).max() <= widest * np.ptp(points[:, 2])
    message = f"{taken} was taken as up, as is usual, but so the plant rather lies than stands; set up_axis"
    return (SourceWarning(code="orientation-uncertain", message=message),) if lying else ()


def _with_trees(capture: Capture, *, is_scan: bool) -> Capture:
    moving = np.flatnonzero(moving_part(capture))
    points = capture.cloud.means[moving].astype(np.float64)
    tree = np.full(capture.cloud.num_gaussians, -1, np.int32)
    tree[moving] = segment_trees(points, is_scan=is_scan)
    count = int(tree.max()) + 1
    if count > 1:
        return replace(capture, tree=tree, warnings=(*capture.warnings, several_trees(count)))
    wide = crown_warnings(np.ptp(points, axis=0).tolist(), capture.cloud.source.scale) if is_scan else ()
    return replace(capture, warnings=capture.warnings + wide)
