"""Sky is separated from leaves to a share of a pixel; walls, lamps and white things below the horizon are no sky."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from PIL import Image, ImageDraw

from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.reconstruct.densify import DensityRules
from dynamictree.reconstruct.depth import DepthMaps, outside_sky, stereo_view
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.sky import without_sky
from dynamictree.reconstruct.splat import fit_splat
from dynamictree.reconstruct.splat_start import initial_table, sky_table
from dynamictree.reconstruct.splat_table import COLOR, MEAN, cloud_of
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.render.camera import Camera

SIDE, FINE, NUM_VIEWS = 160, 4, 10
SKY = slice(0, SIDE // 2 - 4)
LEAF, CROWN = (50, 90, 30), np.array([0, 0, 1.4])
BLUE, WHITE, EVENING = (110, 160, 225), (225, 225, 230), (225, 150, 90)


@cache
def leaves_in_the_open(sky: tuple[int, int, int]) -> tuple[list[View], list[np.ndarray]]:
    """Photos at eye level of leaves in the air above a lawn, and how much of each pixel a leaf covers."""
    rng = np.random.default_rng(0)
    leaves = CROWN + 0.3 * rng.uniform(-1, 1, (80, 3))
    views, covers = [], []
    for turn in 2 * np.pi * np.arange(NUM_VIEWS) / NUM_VIEWS:
        place = np.array([3 * np.cos(turn), 3 * np.sin(turn), 1.0])
        camera = Camera.look_at(place, np.array([0, 0, 1.0]), vertical_fov_deg=40.0)
        mask = Image.new("L", (FINE * SIDE, FINE * SIDE))
        draw = ImageDraw.Draw(mask)
        for x, y, depth in camera.project(leaves, FINE * SIDE, FINE * SIDE):
            radius = 40 / depth
            draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=255)
        cover = np.asarray(mask.resize((SIDE, SIDE), Image.Resampling.BOX)) / 255
        height = np.arange(SIDE)[:, None, None]
        behind = np.where(height < SIDE / 2, sky - 0.2 * height + 8, np.array([60, 80, 30]) + 0.3 * height)
        image = cover[..., None] * np.array(LEAF) + (1 - cover[..., None]) * behind
        views.append(
            View(source=f"{turn:.2f}.png", image=np.rint(np.clip(image, 0, 255)).astype(np.uint8), camera=camera)
        )
        covers.append(cover)
    return views, covers


@cache
def blue_sky() -> list[View]:
    """Cover of the leaves before a blue sky."""
    views, _ = leaves_in_the_open(BLUE)
    return without_sky(views, unmeasured(views))


def unmeasured(views: list[View]) -> list[np.ndarray]:
    return [np.zeros(view.image.shape[:2], np.float32) for view in views]


@pytest.mark.parametrize("sky", [BLUE, WHITE])
def test_a_pixel_is_as_much_leaf_as_was_drawn(sky: tuple[int, int, int]) -> None:
    views, covers = leaves_in_the_open(sky)
    split = without_sky(views, unmeasured(views))
    for view, cover in zip(split, covers, strict=True):
        upper = slice(0, SIDE // 2)
        assert np.abs(view.alpha[upper] / 255 - cover[upper]).mean() < 0.01
        assert (view.alpha[SIDE // 2 + 5 :] == 255).all()
        edge = (cover[upper] > 0.3) & (cover[upper] < 0.7)
        assert np.abs(view.image[upper][edge] - np.array(LEAF)).mean() < 0.08 * 255


def test_an_evening_a_table_below_the_horizon_a_wall_and_a_sky_in_few_photos_are_no_sky() -> None:
    evening, white, blue = (leaves_in_the_open(sky)[0] for sky in (EVENING, WHITE, BLUE))
    upside_down = [replace(view, image=view.image[::-1].copy()) for view in white]
    indoors = [replace(view, image=np.full_like(view.image, 60)) for view in blue]
    for views in (evening, upside_down, [*blue[:4], *indoors[4:]]):
        assert without_sky(views, unmeasured(views)) is None
    assert without_sky(white, [np.full((40, 40), 3.0, np.float32) for _ in white]) is None  # stereo measures it


def test_stereo_gives_the_sky_no_depth() -> None:
    views, covers = leaves_in_the_open(BLUE)
    everywhere = [np.full((80, 80), 2.0, np.float32) for _ in views]
    maps = outside_sky(DepthMaps(views=[stereo_view(view, 80) for view in views], depths=everywhere), blue_sky())
    for depth, cover in zip(maps.depths, covers, strict=True):
        upper = cover.reshape(80, 2, 80, 2).mean(axis=(1, 3))[:40]
        assert (depth[:40][upper > 0.8] == 2).all()
        assert (depth[:40][upper < 0.2] == 0).all()
        assert (depth[41:] == 2).all()


def model_of(views: list[View]) -> SparseModel:
    points = CROWN + 0.3 * np.random.default_rng(1).uniform(-1, 1, (200, 3))
    seen = np.stack(np.meshgrid(np.arange(len(views)), np.arange(200), indexing="ij"), axis=2).reshape(-1, 2)
    colors = np.full((200, 3), LEAF, np.uint8)
    return SparseModel(views=tuple(views), points=points, colors=colors, seen=seen, reprojection_error_px=0.5)


def test_a_splat_begins_without_sky() -> None:
    views, _ = leaves_in_the_open(BLUE)
    rng = np.random.default_rng(0)
    table = initial_table(model_of(views), None, number=2000, sh_degree=0, sky=blue_sky(), rng=rng)
    far = table[np.linalg.norm(table[:, MEAN], axis=1) > 5]
    assert len(far) > 50
    red, _, blue = far[:, COLOR].T
    assert (blue < red).mean() > 0.97


def test_the_sky_goes_on_beyond_the_photos() -> None:
    views, _ = leaves_in_the_open(BLUE)
    behind = cloud_of(sky_table(views, blue_sky(), 0))
    wider = replace(views[0].camera, focal=0.8 * views[0].camera.focal)
    picture = render_cloud(behind, wider, width=SIDE, height=SIDE)
    assert picture.alpha[: SIDE // 2].min() > 0.9
    red, _, blue = (picture.color[: SIDE // 2] / picture.alpha[: SIDE // 2, :, None]).mean(axis=(0, 1))
    assert blue - red == pytest.approx((BLUE[2] - BLUE[0]) / 255, abs=0.05)


def test_what_is_learned_before_a_sky_is_leaves_alone() -> None:
    views, covers = leaves_in_the_open(BLUE)
    schedule = Schedule(num_steps=100, side_px=SIDE, sh_degree=0, rules=DensityRules(max_gaussians=4000))
    fit = fit_splat(model_of(views), None, schedule, sky=blue_sky())
    near = cloud_of(fit.table[np.linalg.norm(fit.table[:, MEAN], axis=1) < 5])
    for view, cover in zip(views, covers, strict=True):
        alpha = render_cloud(near, view.camera, width=SIDE, height=SIDE).alpha[SKY]
        assert alpha[cover[SKY] == 0].mean() < 0.05
        assert alpha[cover[SKY] == 1].mean() > 0.6
