"""Start points in a crown too thin for stereo: where photos from all around show texture."""

from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from dynamictree.reconstruct.densify import DensityRules, before_cameras
from dynamictree.reconstruct.splat_start import first_table
from dynamictree.reconstruct.splat_table import MEAN, table_of_points
from dynamictree.reconstruct.views import View
from dynamictree.reconstruct.visual_hull import texture_points, textured_mask
from tests.reconstruct.conftest import Orbit
from tests.reconstruct.test_coloured_mesh import model_of, views_of

WIDTH, HEIGHT = 320, 240


def crown_before_a_sky(orbit: Orbit, leaves: np.ndarray) -> list[View]:
    """Photos of small leaves before a smooth sky; no ground."""
    views = []
    for view in views_of(orbit):
        sky = np.linspace(200, 235, HEIGHT)[:, None, None] + np.zeros((HEIGHT, WIDTH, 3)) + [0, 5, 15]
        picture = Image.fromarray(sky.astype(np.uint8))
        draw = ImageDraw.Draw(picture)
        for x, y, _ in view.camera.project(leaves, WIDTH, HEIGHT):
            draw.ellipse([x - 2, y - 2, x + 2, y + 2], fill=(40, 80, 20))
        views.append(replace(view, image=np.array(picture)))
    return views


def leaves_of(rng: np.random.Generator) -> np.ndarray:
    """Scattered in a ball above the ground."""
    around = rng.normal(size=(60, 3))
    around *= 0.3 * rng.uniform(size=(60, 1)) ** (1 / 3) / np.linalg.norm(around, axis=1, keepdims=True)
    return around + np.array([0, 0, 0.6])


def test_every_leaf_of_a_crown_has_points(orbit: Orbit, rng: np.random.Generator) -> None:
    leaves = leaves_of(rng)
    points, colors = texture_points(crown_before_a_sky(orbit, leaves), 4000, rng)
    assert 1000 < len(points) <= 4000
    assert colors.shape == points.shape
    assert cKDTree(points).query(leaves)[0].max() < 0.05
    assert np.linalg.norm(points - [0, 0, 0.6], axis=1).max() < 0.4  # not in the sky


def test_plain_pictures_have_none(orbit: Orbit, rng: np.random.Generator) -> None:
    sky = crown_before_a_sky(orbit, np.zeros((0, 3)))
    assert not textured_mask(sky[0].image).any()
    assert len(texture_points(sky, 1000, rng)[0]) == 0


def test_a_splat_begins_in_the_crown_unless_masks_say_where_the_plant_is(
    orbit: Orbit, rng: np.random.Generator
) -> None:
    views = crown_before_a_sky(orbit, leaves_of(rng))
    model = replace(model_of(orbit, rng), views=tuple(views))
    low = model.points[:, 2] < 0.2
    model = replace(model, points=model.points[low], colors=model.colors[low])

    def number_in_crown(masked: bool) -> int:
        alpha = np.full((HEIGHT, WIDTH), 255, np.uint8)
        alpha[: HEIGHT // 2] = 0
        own = [replace(view, alpha=alpha if masked else None) for view in views]
        table = first_table(
            replace(model, views=tuple(own)), None, number=2000, sh_degree=0, rng=np.random.default_rng(1)
        )
        return int((np.linalg.norm(table[:, MEAN] - [0, 0, 0.6], axis=1) < 0.3).sum())

    assert number_in_crown(masked=False) > 300
    assert number_in_crown(masked=True) < 100


def test_gaussians_where_a_camera_was_are_no_part_of_the_scene() -> None:
    cameras = np.array([[2.0, 0, 1], [0, 2.0, 1], [-2.0, 0, 1]])
    places = np.float32([[2.0, 0, 1], [1.9, 0, 1], [1.5, 0, 1], [0, 0, 0.5], [0, 1.95, 1.1]])
    table = table_of_points(places, np.zeros((5, 3), np.float32), np.ones(5, np.float32), opacity=0.5, sh_degree=0)
    assert before_cameras(table, cameras, DensityRules()).tolist() == [True, True, False, False, True]
