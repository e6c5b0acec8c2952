"""Warn if the moving part does not look like a plant: rotationally symmetric, boxy, smooth, flat or tiny shapes.

A crown is uneven: the surface distributions of eight sectors around the middle differ by 0.40 or more for trees (28
generated, six files) and by 0.07 or less for surfaces of revolution. At most 9 % of a tree's surface faces along an
axis, all of a chair's does. The share of points (one per cell) that lie flat among their neighbours is 3 to 47 % for
plants (14 generated, two captures) and 75 to 100 % for a stump, a car, a robot and a ball. Low-poly conifers are cones
and voxel trees are boxes, so green objects, names of wood or leaves, and meshes of very few faces raise no warning.
"""

from io import BytesIO

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Bool, Float64
from PIL import Image

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import Material, SourceWarning, TriangleMesh
from dynamictree.planes import NEIGHBOURS, Points, flat_points
from dynamictree.plant.names import LEAF, WOOD
from dynamictree.plant.sample import face_normals, surface_points
from dynamictree.plant.still import touching_groups

FEWEST_FACES = 40
"""Least number of faces that form a shape; a single card does not."""
FEWEST_GAUSSIANS = 500
"""Least number of Gaussians that can look like a plant."""
VISIBLE = 0.1
"""Least opacity of visible Gaussians."""
_POINTS = 20_000
_TURNED, _BOXY, _SMOOTH = 0.2, 0.9, 0.65
"""No plants: less difference between sectors, or a larger share of surface along axes or of flat points."""
_GREEN_RATIO, _GREEN_SHARE = 1.05, 0.1  # ratio of green to red and blue; share of the faces or points
_CELL, _TOGETHER = 0.03, 0.5  # share of the height, within which points are connected; least connected share of a plant


def doubt_mesh(mesh: TriangleMesh) -> tuple[SourceWarning, ...]:
    """Warn if the moving part of a mesh with +Z up does not look like a plant."""
    plant = mesh.moving_part
    sampled = surface_points(plant, _POINTS)
    if sampled is None or plant.num_faces < FEWEST_FACES:
        return ()
    if sector_difference(sampled[0]) < _TURNED:
        shape = "the same from all sides, as lamps, vases and columns are"
    elif _share_along_axes(plant) > _BOXY:
        shape = "made of boxes, as furniture and houses are"
    else:
        return ()
    return () if _has_plant_colors(plant) else _unlike(shape)


def doubt_cloud(plant: GaussianCloud) -> tuple[SourceWarning, ...]:
    """Warn if the moving part of a cloud is tiny, flat, disconnected or smooth."""
    flat = 0.25  # height over width; below it nothing stands upright
    points = plant.means.astype(np.float64)
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    width, height = float((high - low)[:2].max()), float((high - low)[2])
    if len(points) < FEWEST_GAUSSIANS:
        message = f"{len(points):,} Gaussians or points can hardly show a plant; usual are 10,000 and more"
    elif height < flat * width:
        message = (
            f"what moves is {height:.3g} m tall and {width:.3g} m wide, so nothing stands upright; "
            "set up_axis if it lies, or box_m to the plant if it is in a scene"
        )
    elif (together := _share_together(plant, height)) < _TOGETHER:
        message = (
            f"what moves are specks far from each other, of which {together:.0%} hang together; those of a plant "
            "touch: send the splat as it was before it was thinned out"
        )
    elif (
        _is_green(plant.sh[:, 0].astype(np.float64) * SH_0 + 0.5).mean() < _GREEN_SHARE
        and _share_flat(points) > _SMOOTH
    ):
        return _unlike("smooth, as machines, statues and furniture are")
    else:
        return ()
    return (SourceWarning(code="not-like-a-plant", message=message),)


def _unlike(shape: str) -> tuple[SourceWarning, ...]:
    message = (
        f"this does not look like a plant: the shape is {shape}, and nothing is green or named for wood or leaves; "
        "name what is to move, or to stand still, with moving and still"
    )
    return (SourceWarning(code="not-like-a-plant", message=message),)


def sector_difference(points: Points) -> float:
    """Compute the mean difference, in [0, 2], between sectors in the distribution of points over height and radius."""
    sectors, heights, radii = 8, 12, 8
    outermost = 0.99  # quantile of the distances from the middle
    across = points[:, :2] - points[:, :2].mean(axis=0)
    away = np.linalg.norm(across, axis=1)
    share = (points[:, 2] - points[:, 2].min()) / max(float(np.ptp(points[:, 2])), 1e-30)
    turn = np.arctan2(across[:, 1], across[:, 0]) / (2 * np.pi) + 0.5
    sector = np.minimum((turn * sectors).astype(int), sectors - 1)
    height = np.minimum((share * heights).astype(int), heights - 1)
    radius = np.minimum((away / max(float(np.quantile(away, outermost)), 1e-30) * radii).astype(int), radii - 1)
    cell = (sector * heights + height) * radii + radius
    spread = np.bincount(cell, minlength=sectors * heights * radii).reshape(sectors, -1) * (sectors / len(points))
    return float(np.abs(spread - spread.mean(axis=0)).sum(axis=1).mean())


def _share_along_axes(mesh: TriangleMesh) -> float:
    normals = face_normals(mesh)
    area = np.linalg.norm(normals, axis=1)
    along = np.abs(normals).max(axis=1) > 0.99 * area  # angle to an axis below 8°
    return float(area[along].sum() / max(float(area.sum()), 1e-30))


def _share_flat(points: Points) -> float:
    """Return the share of points (one per cell) that lie flat among their neighbours."""
    fine = 0.008  # share of the diagonal; a cell's side
    thinned = one_per_cell(points, fine * float(np.linalg.norm(np.ptp(points, axis=0))))
    thinned = thinned[np.random.default_rng(0).permutation(len(thinned))[:_POINTS]]
    return float(flat_points(thinned).flat.mean()) if len(thinned) > NEIGHBOURS else 0.0


def one_per_cell(points: Points, cell: float) -> Points:
    """Return the first point in each cell of a grid."""
    if cell <= 0:
        return points
    _, first = np.unique(np.floor((points - points.min(axis=0)) / cell).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def _share_together(cloud: GaussianCloud, height_m: float) -> float:
    """Return the share of visible Gaussians in the largest group; 1 if they are not small compared to their gaps."""
    wide_gap = 4.0  # [middle standard deviation]; Gaussians with larger gaps are specks
    cloud = cloud.subset(cloud.opacity >= VISIBLE)
    if cloud.num_gaussians < 2:
        return 1.0
    points = cloud.means.astype(np.float64)
    some = np.random.default_rng(0).permutation(len(points))[: _POINTS // 4]
    gap = np.asarray(scipy.spatial.cKDTree(points).query(points[some], k=2)[0])[:, 1]
    if np.median(gap) < wide_gap * np.median(np.sort(cloud.scales[some], axis=1)[:, 1]):
        return 1.0
    _, _, count, group = touching_groups(points, _CELL * height_m)
    return float(np.bincount(group, count).max() / len(points))


def _has_plant_colors(mesh: TriangleMesh) -> bool:
    green = np.zeros(mesh.num_faces, np.bool_)
    if mesh.look.vertex_colors is not None:
        green |= _is_green(mesh.look.vertex_colors[mesh.faces][:, :, :3].astype(np.float64).mean(axis=1))
    if mesh.look.face_material is not None and mesh.look.materials:
        green |= np.array([_is_of_plant(material) for material in mesh.look.materials])[mesh.look.face_material]
    return bool(green.mean() >= _GREEN_SHARE)


def _is_green(colors: Float64[np.ndarray, "N 3"]) -> Bool[np.ndarray, " N"]:
    return np.asarray(colors[:, 1] > _GREEN_RATIO * colors[:, [0, 2]].max(axis=1))


def _is_of_plant(material: Material) -> bool:
    if WOOD.search(material.name) or LEAF.search(material.name):
        return True
    color = np.array(material.base_color[:3])
    if material.texture_png is not None:
        with Image.open(BytesIO(material.texture_png)) as picture:
            red, green, blue = np.asarray(picture.convert("RGB").resize((1, 1), Image.Resampling.BOX))[0, 0] / 255
        color = color * (red, green, blue)
    return bool(_is_green(color[None])[0])
