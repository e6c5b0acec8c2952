"""Start points of thin plants: in the hull of masks that may be exact, narrow or partly wrong, and of texture."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from dynamictree.errors import ReconstructionError
from dynamictree.reconstruct.splat_start import initial_table
from dynamictree.reconstruct.splat_table import MEAN
from dynamictree.reconstruct.views import View
from dynamictree.reconstruct.visual_hull import hull_points, texture_points, textured_mask
from tests.reconstruct.conftest import Orbit
from tests.reconstruct.test_coloured_mesh import model_of, views_of

WIDTH, HEIGHT = 240, 180


def twigs_of(rng: np.random.Generator, number: int) -> np.ndarray:
    first, last = rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 1], (2, number, 3))
    return (first + np.linspace(0, 1, 300)[:, None, None] * (last - first)).reshape(-1, 3)


def masked_views(orbit: Orbit, points: np.ndarray) -> tuple[View, ...]:
    """Photos whose masks are one pixel wide where the points are."""
    views = []
    for view in views_of(orbit):
        image = np.array(Image.fromarray(view.image).resize((WIDTH, HEIGHT), Image.Resampling.BOX))
        x, y, _ = view.camera.project(points, WIDTH, HEIGHT).T
        alpha = np.zeros((HEIGHT, WIDTH), np.uint8)
        alpha[y.astype(int), x.astype(int)] = 255
        views.append(replace(view, image=image, alpha=alpha))
    return tuple(views)


def test_one_stem_gives_points_along_all_of_it(orbit, rng):
    """A single stem one pixel wide: random places of the whole region hardly ever hit it."""
    stem = np.stack([np.full(400, 0.05), np.full(400, -0.03), np.linspace(0, 1, 400)], axis=1)
    points, _ = hull_points(masked_views(orbit, stem), 5000, rng)
    assert len(points) > 1000
    assert (cKDTree(points).query(stem)[0] < 0.02).all()
    assert cKDTree(stem).query(points)[0].max() < 0.06
    model = model_of(orbit, rng)
    bare = replace(model, views=masked_views(orbit, stem), points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))
    table = initial_table(bare, None, number=2000, sh_degree=1, rng=rng)
    assert 500 < len(table) < 2100
    assert np.isfinite(table).all()


@pytest.mark.parametrize("off_px", [0, 1])
def test_neither_a_wrong_mask_in_eight_nor_cameras_that_are_off_by_a_pixel_lose_a_twig(orbit, rng, off_px):
    twigs = twigs_of(rng, 6)
    views = [
        replace(view, alpha=np.roll(view.alpha, rng.integers(-off_px, off_px + 1, 2), axis=(0, 1)))
        for view in masked_views(orbit, twigs)
    ]
    if not off_px:
        views[4] = replace(views[4], alpha=np.zeros_like(views[4].alpha))
    assert (cKDTree(hull_points(views, 5000, rng)[0]).query(twigs)[0] < 0.03).all()


def test_masks_that_do_not_fit_together_are_an_error_with_advice(orbit, rng):
    views = [replace(view, alpha=np.zeros_like(view.image[..., 0])) for view in views_of(orbit)]
    with pytest.raises(ReconstructionError, match=r"masks of 14 photos agree on no place in space; .*check the masks"):
        hull_points(views, 1000, rng)


def crown_before_a_sky(orbit: Orbit, leaves: np.ndarray) -> list[View]:
    """Photos of small leaves before a smooth sky; no ground."""
    views = []
    for view in views_of(orbit):
        sky = np.linspace(200, 235, 240)[:, None, None] + np.zeros((240, 320, 3)) + [0, 5, 15]
        picture = Image.fromarray(sky.astype(np.uint8))
        draw = ImageDraw.Draw(picture)
        for x, y, _ in view.camera.project(leaves, 320, 240):
            draw.ellipse([x - 2, y - 2, x + 2, y + 2], fill=(40, 80, 20))
        views.append(replace(view, image=np.array(picture)))
    return views


def leaves_of(rng: np.random.Generator) -> np.ndarray:
    """Scattered in a ball above the ground."""
    around = rng.normal(size=(60, 3))
    around *= 0.3 * rng.uniform(size=(60, 1)) ** (1 / 3) / np.linalg.norm(around, axis=1, keepdims=True)
    return around + np.array([0, 0, 0.6])


def test_every_leaf_of_a_crown_has_points(orbit: Orbit, rng) -> None:
    leaves = leaves_of(rng)
    points, colors = texture_points(crown_before_a_sky(orbit, leaves), 4000, rng)
    assert 1000 < len(points) <= 4000
    assert colors.shape == points.shape
    assert cKDTree(points).query(leaves)[0].max() < 0.05
    assert np.linalg.norm(points - [0, 0, 0.6], axis=1).max() < 0.4  # not in the sky


def test_plain_pictures_have_none(orbit: Orbit, rng) -> None:
    sky = crown_before_a_sky(orbit, np.zeros((0, 3)))
    assert not textured_mask(sky[0].image).any()
    assert len(texture_points(sky, 1000, rng)[0]) == 0


def test_a_splat_begins_in_the_crown_unless_masks_say_where_the_plant_is(orbit: Orbit, rng) -> None:
    views = crown_before_a_sky(orbit, leaves_of(rng))
    model = replace(model_of(orbit, rng), views=tuple(views))
    low = model.points[:, 2] < 0.2
    model = replace(model, points=model.points[low], colors=model.colors[low])

    def number_in_crown(masked: bool) -> int:
        alpha = np.full((240, 320), 255, np.uint8)
        alpha[: 240 // 2] = 0
        own = [replace(view, alpha=alpha if masked else None) for view in views]
        table = initial_table(
            replace(model, views=tuple(own)), None, number=2000, sh_degree=0, rng=np.random.default_rng(1)
        )
        return int((np.linalg.norm(table[:, MEAN] - [0, 0, 0.6], axis=1) < 0.3).sum())

    assert number_in_crown(masked=False) > 300
    assert number_in_crown(masked=True) < 100
