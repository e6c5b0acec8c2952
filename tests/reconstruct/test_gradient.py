"""Gradients of pictures of Gaussians, against autograd of the slow twin and against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize import draw
from dynamictree.reconstruct.gradient import Gradients, gradients_of
from dynamictree.render.camera import Camera
from tests.gaussian.slow_splat import Leaves, draw_slowly

COLUMNS = {
    "means": slice(0, 3),
    "quaternions": slice(3, 7),
    "log_scales": slice(7, 10),
    "logit_opacity": slice(10, 11),
    "sh": slice(11, None),
}
WIDTH, HEIGHT = 41, 35  # no whole number of tiles
FIELDS = tuple(COLUMNS)
CAMERA = Camera.look_at(np.array([0.3, -2.0, 0.4]), np.zeros(3), vertical_fov_deg=30.0)
NEAR = Camera.look_at(np.array([0.1, -0.45, 0.05]), np.zeros(3), vertical_fov_deg=60.0)  # some beyond the widest slope


def leaves_of(rng: np.random.Generator, *, number: int = 14, degree: int = 1) -> dict[str, np.ndarray]:
    turns = rng.normal(size=(number, 4))
    return {
        "means": rng.uniform(-0.5, 0.5, (number, 3)),
        "quaternions": turns / np.linalg.norm(turns, axis=1, keepdims=True),
        "log_scales": np.log(rng.uniform(0.03, 0.2, (number, 3))),
        "logit_opacity": rng.normal(size=number) + 1,
        "sh": 0.3 * rng.normal(size=(number, (degree + 1) ** 2, 3)),
    }


def needles_of(rng: np.random.Generator, *, number: int, thickness_m: tuple[float, float]) -> dict[str, np.ndarray]:
    """Gaussians that are far longer than thick, as twigs and leaf edges become while they are learned."""
    leaves = leaves_of(rng, number=number)
    leaves["log_scales"] = rng.uniform(*np.log(thickness_m), (number, 3))
    leaves["log_scales"][:, 0] = rng.uniform(np.log(0.05), np.log(0.8), number)
    return {name: values.astype(np.float32).astype(np.float64) for name, values in leaves.items()}


def cloud_of(leaves: dict[str, np.ndarray]) -> GaussianCloud:
    return GaussianCloud(
        means=leaves["means"].astype(np.float32),
        quaternions=leaves["quaternions"].astype(np.float32),
        scales=np.exp(leaves["log_scales"]).astype(np.float32),
        opacity=(1 / (1 + np.exp(-leaves["logit_opacity"]))).astype(np.float32),
        sh=leaves["sh"].astype(np.float32),
    )


def by(gradients: Gradients, name: str) -> np.ndarray:
    return gradients.table[:, COLUMNS[name]]


def smooth_noise(rng: np.random.Generator) -> np.ndarray:
    return gaussian_filter(rng.normal(size=(HEIGHT, WIDTH, 5)), (3, 3, 0)).astype(np.float32)


def assert_autograds(rng, values, camera, *, picture, relative):
    """Both passes equal those of the slow twin, to `picture` and to `relative` of each largest gradient."""
    drawing = draw(cloud_of(values), camera, width=WIDTH, height=HEIGHT)
    leaves = Leaves(**{name: torch.tensor(value, requires_grad=True) for name, value in values.items()})
    slow = draw_slowly(leaves, camera, width=WIDTH, height=HEIGHT)
    assert np.abs(slow.detach().numpy() - drawing.picture).max() < picture
    gradient = smooth_noise(rng)
    (slow * torch.tensor(gradient)).sum().backward()
    gradients = gradients_of(drawing, gradient)
    for name in FIELDS:
        true = getattr(leaves, name).grad.numpy().reshape(len(gradients.table), -1)
        assert np.abs(true).max() > 1e-3, name
        assert np.abs(by(gradients, name) - true).max() < relative * np.abs(true).max(), name


@pytest.mark.parametrize("camera", [CAMERA, NEAR], ids=["far", "near"])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_gradients_are_autograds_of_the_slow_twin(camera, degree):
    rng = np.random.default_rng(0)  # where no alpha is within rounding of the least, at which a picture jumps
    values = leaves_of(rng, degree=degree)
    assert_autograds(rng, values, camera, picture=2e-5, relative=3e-4)


def test_gradients_of_needles_are_autograds_of_the_slow_twin():
    rng = np.random.default_rng(1)
    values = needles_of(rng, number=40, thickness_m=(1e-3, 5e-3))
    assert_autograds(rng, values, CAMERA, picture=1e-4, relative=1e-3)


def test_gradients_of_needles_are_finite():
    """352 of these 20,000 rows were not while the determinant was the difference of two products."""
    rng = np.random.default_rng(0)
    values = needles_of(rng, number=20_000, thickness_m=(1e-5, 1e-3))
    drawing = draw(cloud_of(values), CAMERA, width=640, height=480)
    gradients = gradients_of(drawing, rng.normal(size=(480, 640, 5)).astype(np.float32))
    assert np.isfinite(gradients.table).all()
    assert (drawing.bounds[:, 1] > drawing.bounds[:, 0]).mean() > 0.9


def test_gaussians_that_are_not_finite_are_not_drawn(rng):
    cloud = cloud_of(leaves_of(rng))
    for row, (name, value) in enumerate((("means", np.nan), ("scales", np.inf), ("opacity", np.nan))):
        getattr(cloud, name)[row] = value
    drawing = draw(cloud, CAMERA, width=WIDTH, height=HEIGHT)
    assert np.isfinite(drawing.picture).all()
    assert not drawing.bounds[:3].any()


def test_what_is_not_seen_has_no_gradient(rng):
    values = leaves_of(rng, number=30)
    behind = np.arange(30) % 2 == 0
    values["means"][behind] += CAMERA.position_m * 2
    gradients = gradients_of(draw(cloud_of(values), CAMERA, width=WIDTH, height=HEIGHT), smooth_noise(rng))
    for name in FIELDS:
        assert not by(gradients, name)[behind].any()
        assert by(gradients, name)[~behind].any()


def test_gradients_do_not_depend_on_the_number_of_threads(rng, monkeypatch):
    cloud = cloud_of(leaves_of(rng, number=300))
    weights = smooth_noise(rng)

    def once() -> Gradients:
        return gradients_of(draw(cloud, CAMERA, width=WIDTH, height=HEIGHT), weights)

    several = once()
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})
    alone = once()
    assert np.array_equal(several.table, alone.table)
    assert np.array_equal(several.centres_px, alone.centres_px)


def test_light_that_is_used_up_ends_a_tiles_list(rng):
    """A thousand layers: gradients stay finite, and the hindmost get none."""
    number = 1000
    depth = np.linspace(0, 1, number)
    flat = replace(
        cloud_of(leaves_of(rng, number=number)),
        means=np.stack([np.zeros(number), depth, np.zeros(number)], axis=1).astype(np.float32),
        scales=np.full((number, 3), 2.0, np.float32),
        opacity=np.full(number, 0.9, np.float32),
    )
    gradients = gradients_of(draw(flat, CAMERA, width=WIDTH, height=HEIGHT), smooth_noise(rng))
    assert np.isfinite(gradients.table).all()
    assert not gradients.table[-900:].any()
    assert gradients.table[0].any()
