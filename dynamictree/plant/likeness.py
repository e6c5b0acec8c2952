"""Doubt that a mesh is a plant: bodies of revolution (lamps, vases, columns) and boxes (furniture, houses).

A crown is uneven: of trees the eight sectors around the middle differ by 0.40 or more in where their surface lies (28
generated ones, six of files), of turned bodies by 0.07 or less; at most 9 % of a tree's surface faces along an axis,
all of a chair's does. Low-poly conifers are cones and voxel trees are boxes, so what is green, or named for wood or
leaves, is not doubted, nor what has so few faces that it has no shape.
"""

from io import BytesIO

import numpy as np
from jaxtyping import Float64
from PIL import Image

from dynamictree.mesh import Material, SourceWarning, TriangleMesh
from dynamictree.plant.upright import LEAF, WOOD, surface_points

_FEWEST_FACES = 40
_TURNED = 0.2  # sectors that differ by less are of a body of revolution
_BOXY = 0.9  # share of surface that faces along an axis
_SECTORS, _HEIGHTS, _RADII = 8, 12, 8
_OUTERMOST = 0.99  # of the distances from the middle
_ALONG = 0.99  # cosine
_GREENER = 1.05  # than red and blue
_GREEN_SHARE = 0.1  # of the faces


def doubt_plant(mesh: TriangleMesh) -> tuple[SourceWarning, ...]:
    """A warning if what moves of a mesh that stands on +Z does not look like a plant."""
    plant = mesh.moving_part
    sampled = surface_points(plant)
    if sampled is None or plant.num_faces < _FEWEST_FACES:
        return ()
    if sector_difference(sampled[0]) < _TURNED:
        shape = "the same from all sides, as lamps, vases and columns are"
    elif _share_along_axes(plant) > _BOXY:
        shape = "made of boxes, as furniture and houses are"
    else:
        return ()
    if _has_plant_colors(plant):
        return ()
    message = f"this does not look like a plant: the shape is {shape}, and nothing is green or named for wood or leaves"
    return (SourceWarning(code="not-like-a-plant", message=message),)


def sector_difference(points: Float64[np.ndarray, "P 3"]) -> float:
    """Mean difference, in [0, 2], between sectors around the middle in how points are spread over height and radius."""
    across = points[:, :2] - points[:, :2].mean(axis=0)
    away = np.linalg.norm(across, axis=1)
    share = (points[:, 2] - points[:, 2].min()) / max(float(np.ptp(points[:, 2])), 1e-30)
    turn = np.arctan2(across[:, 1], across[:, 0]) / (2 * np.pi) + 0.5
    sector = np.minimum((turn * _SECTORS).astype(int), _SECTORS - 1)
    height = np.minimum((share * _HEIGHTS).astype(int), _HEIGHTS - 1)
    radius = np.minimum((away / max(float(np.quantile(away, _OUTERMOST)), 1e-30) * _RADII).astype(int), _RADII - 1)
    cell = (sector * _HEIGHTS + height) * _RADII + radius
    spread = np.bincount(cell, minlength=_SECTORS * _HEIGHTS * _RADII).reshape(_SECTORS, -1) * (_SECTORS / len(points))
    return float(np.abs(spread - spread.mean(axis=0)).sum(axis=1).mean())


def _share_along_axes(mesh: TriangleMesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    along = np.abs(normals).max(axis=1) > _ALONG * area
    return float(area[along].sum() / max(float(area.sum()), 1e-30))


def _has_plant_colors(mesh: TriangleMesh) -> bool:
    green = np.zeros(mesh.num_faces, np.bool_)
    if mesh.vertex_colors is not None:
        colors = mesh.vertex_colors[mesh.faces][:, :, :3].astype(np.float64).mean(axis=1)
        green |= colors[:, 1] > _GREENER * colors[:, [0, 2]].max(axis=1)
    if mesh.face_material is not None and mesh.materials:
        green |= np.array([_is_of_plant(material) for material in mesh.materials])[mesh.face_material]
    return bool(green.mean() >= _GREEN_SHARE)


def _is_of_plant(material: Material) -> bool:
    if WOOD.search(material.name) or LEAF.search(material.name):
        return True
    color = np.array(material.base_color[:3])
    if material.texture_png is not None:
        with Image.open(BytesIO(material.texture_png)) as picture:
            red, green, blue = np.asarray(picture.convert("RGB").resize((1, 1), Image.Resampling.BOX))[0, 0] / 255
        color = color * (red, green, blue)
    return bool(color[1] > _GREENER * max(color[0], color[2]))
