"""Points in the visual hull of thin plants, whose masks may be exact, narrow or partly wrong."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from dynamictree.errors import ReconstructionError
from dynamictree.reconstruct.splat_start import first_table
from dynamictree.reconstruct.views import View
from dynamictree.reconstruct.visual_hull import hull_points
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


def test_thin_twigs_are_filled_with_points(orbit, rng):
    twigs = twigs_of(rng, 12)
    views = masked_views(orbit, twigs)
    points, colors = hull_points(views, 20_000, rng)
    assert len(points) >= 20_000
    assert colors.shape == points.shape
    assert (cKDTree(points).query(twigs)[0] < 0.02).all()  # no twig is left out
    inside = []
    for view in views:
        x, y, depth = view.camera.project(points, WIDTH, HEIGHT).T
        assert (depth > 0).all()
        inside.append(binary_dilation(view.alpha > 0, iterations=2)[y.astype(int), x.astype(int)])
    assert np.mean(inside, axis=0).min() >= 7 / 8


def test_one_stem_gives_points_along_all_of_it(orbit, rng):
    """A single stem one pixel wide: random places of the whole region hardly ever hit it."""
    stem = np.stack([np.full(400, 0.05), np.full(400, -0.03), np.linspace(0, 1, 400)], axis=1)
    points, _ = hull_points(masked_views(orbit, stem), 5000, rng)
    assert len(points) > 1000
    assert (cKDTree(points).query(stem)[0] < 0.02).all()
    assert cKDTree(stem).query(points)[0].max() < 0.06
    model = model_of(orbit, rng)
    bare = replace(model, views=masked_views(orbit, stem), points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))
    table = first_table(bare, None, number=2000, sh_degree=1, rng=rng)
    assert 500 < len(table) < 2100
    assert np.isfinite(table).all()


def test_one_wrong_mask_in_eight_cuts_no_hole(orbit, rng):
    twigs = twigs_of(rng, 6)
    views = list(masked_views(orbit, twigs))
    views[4] = replace(views[4], alpha=np.zeros_like(views[4].alpha))
    points, _ = hull_points(views, 5000, rng)
    assert (cKDTree(points).query(twigs)[0] < 0.03).all()


def test_cameras_that_are_off_by_a_pixel_lose_no_twig(orbit, rng):
    twigs = twigs_of(rng, 6)
    views = [replace(view, alpha=np.roll(view.alpha, rng.integers(-1, 2, 2), axis=(0, 1)))
             for view in masked_views(orbit, twigs)]  # fmt: skip
    points, _ = hull_points(views, 5000, rng)
    assert (cKDTree(points).query(twigs)[0] < 0.03).all()


def test_masks_that_do_not_fit_together_are_an_error_with_advice(orbit, rng):
    views = [
        replace(view, alpha=np.zeros((HEIGHT, WIDTH), np.uint8), image=np.zeros((HEIGHT, WIDTH, 3), np.uint8))
        for view in views_of(orbit)
    ]
    with pytest.raises(ReconstructionError, match=r"masks of 14 photos agree on no place in space; .*check the masks"):
        hull_points(views, 1000, rng)


def test_photos_without_masks_have_no_hull(orbit, rng):
    points, colors = hull_points(views_of(orbit), 1000, rng)
    assert points.shape == colors.shape == (0, 3)
