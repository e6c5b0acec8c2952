"""Photos that a camera exposed differently are brought into one light; photos in one light stay as they are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynamictree.reconstruct.exposure import equalise_exposure, log_gains
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.render.camera import Camera
from tests.reconstruct.conftest import sparse_model

Gains = tuple[tuple[float, ...], ...]
SIDE_PX, NUM_VIEWS, NUM_POINTS = 400, 12, 400


@cache
def photographed(gains: Gains) -> SparseModel:
    """Coloured points on a ball, each seen from its own side, as squares of five pixels before grey."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(NUM_POINTS, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    colors = rng.uniform(60, 120, (NUM_POINTS, 3))
    views, seen = [], []
    for row, gain in enumerate(gains):
        turn = 2 * np.pi * row / len(gains)
        place = 4 * np.array([np.cos(turn), np.sin(turn), 0])
        camera = Camera.look_at(place, np.zeros(3), vertical_fov_deg=40.0)
        image = np.full((SIDE_PX, SIDE_PX, 3), 30.0)
        x, y, depth = camera.project(points, SIDE_PX, SIDE_PX).T
        for point in np.argsort(-depth):
            column, line = int(x[point]), int(y[point])
            image[max(line - 2, 0) : line + 3, max(column - 2, 0) : column + 3] = colors[point] * np.array(gain)
        near = np.flatnonzero(depth < 3.6)
        seen += [(row, point) for point in near]
        views.append(View(source=f"{row}.jpg", image=np.rint(image).astype(np.uint8), camera=camera))
    return sparse_model(views, points, seen, colors)


ALIKE = ((1.0,) * 3,) * NUM_VIEWS
UNEVEN = np.exp(0.2 * np.random.default_rng(1).normal(size=(NUM_VIEWS, 3)))


def uneven() -> SparseModel:
    return photographed(tuple(map(tuple, UNEVEN.tolist())))


def test_gains_are_those_of_the_camera() -> None:
    expected = np.log(UNEVEN) - np.log(UNEVEN).mean(axis=0)
    assert np.abs(log_gains(uneven()) - expected).max() < 0.03


def test_photos_are_brought_into_one_light() -> None:
    assert np.abs(log_gains(equalise_exposure(uneven()))).max() < 0.02


def test_photos_in_one_light_stay_as_they_are() -> None:
    model = photographed(ALIKE)
    assert equalise_exposure(model) is model


@pytest.mark.parametrize("share", [0.0, 0.02])
def test_a_photo_of_few_points_stays_as_it_is(share: float) -> None:
    model, dark = photographed(ALIKE), photographed(((0.5,) * 3, *ALIKE[1:]))
    few = model.seen[:, 0] > 0
    few[np.flatnonzero(~few)[: int(share * NUM_POINTS)]] = True
    assert np.array_equal(equalise_exposure(replace(dark, seen=model.seen[few])).views[0].image, dark.views[0].image)
