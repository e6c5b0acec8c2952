"""A splat that is learned from pictures of a known thing; the optimiser's parts, each by its law."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from dynamictree.errors import Cancelled
from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.reconstruct.adam import adam_step
from dynamictree.reconstruct.densify import DensityRules, densify
from dynamictree.reconstruct.gradient import gradients_of
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.picture_loss import picture_loss, psnr, ssim
from dynamictree.reconstruct.splat import fit_splat, held_out_views
from dynamictree.reconstruct.splat_start import subsample
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import LOG_SCALE, LOGIT, MEAN, cloud_of, table_of_points
from dynamictree.reconstruct.views import SparseModel, View
from tests.reconstruct.conftest import Orbit
from tests.reconstruct.test_coloured_mesh import model_of

FEW = DensityRules(max_gaussians=3000)
SMALL = Schedule(
    num_steps=120, side_px=120, check_every=40, coarser=((0.4, 2),), densify_every=20, degree_every=20, rules=FEW
)


def small_model(orbit: Orbit, rng: np.random.Generator, *, cut: bool = False) -> SparseModel:
    """Photos of 120 pixels, and points as structure from motion would give them, in the photos' colours."""
    model = model_of(orbit, rng)
    views = []
    for view in model.views:
        image = np.array(Image.fromarray(view.image).resize((120, 90), Image.Resampling.BOX))
        alpha = None
        if cut:
            alpha = np.zeros((90, 120), np.uint8)
            alpha[:, 30:90] = 255
        views.append(View(source=view.source, image=image, camera=view.camera, alpha=alpha))
    x, y, _ = model.views[0].camera.project(model.points, 120, 90).T
    at = np.clip(y, 0, 89).astype(int), np.clip(x, 0, 119).astype(int)
    return replace(model, views=tuple(views), colors=views[0].image[at])


def test_a_splat_learns_to_show_photos_that_it_was_not_shown(orbit, rng):
    fit = fit_splat(small_model(orbit, rng), None, SMALL)
    assert fit.figures["held_out"] == ["photo_03.jpg", "photo_10.jpg"]
    assert fit.figures["held_out_size_px"] == [120, 90]
    assert np.mean(fit.figures["held_out_psnr_db"]) > np.mean(fit.figures["held_out_blank_psnr_db"]) + 5
    assert fit.figures["held_out_masked_psnr_db"] == []
    assert 0.3 < min(fit.figures["held_out_ssim"]) <= max(fit.figures["held_out_ssim"]) < 1


def test_the_photos_that_judge_have_no_say_in_the_result(orbit, rng):
    model, schedule = small_model(orbit, rng), replace(SMALL, num_steps=24, check_every=8)
    fit = fit_splat(model, None, schedule)
    noise = [
        replace(view, image=rng.integers(0, 256, view.image.shape, np.uint8))
        if view.source in fit.figures["held_out"]
        else view
        for view in model.views
    ]
    other = fit_splat(replace(model, views=tuple(noise)), None, schedule)
    np.testing.assert_array_equal(other.table, fit.table)
    assert np.mean(other.figures["held_out_psnr_db"]) < np.mean(fit.figures["held_out_psnr_db"]) - 1


@pytest.mark.slow
def test_where_photos_are_cut_out_nothing_is_left(orbit, rng):
    model = small_model(orbit, rng, cut=True)
    fit = fit_splat(model, None, replace(SMALL, num_steps=120))
    assert all(
        inside < whole
        for inside, whole in zip(fit.figures["held_out_masked_psnr_db"], fit.figures["held_out_psnr_db"], strict=True)
    )  # the black is easy
    for view in model.views[:3]:
        alpha = render_cloud(cloud_of(fit.table), view.camera, width=120, height=90).alpha
        assert alpha[:, :24].mean() < 0.25 * alpha[:, 36:84].mean()


def test_a_run_that_was_stopped_goes_on_to_the_same_end(orbit, rng, tmp_path):
    model = small_model(orbit, rng)
    schedule = replace(SMALL, num_steps=24, check_every=8, densify_every=8, degree_every=8)
    whole = fit_splat(model, None, schedule, saved=tmp_path / "whole.npz")

    def stop(state: SplatState) -> None:
        if state.step > 0:
            raise Cancelled("enough")

    with pytest.raises(Cancelled):
        fit_splat(model, None, schedule, saved=tmp_path / "splat.npz", on_state=stop)
    assert 0 < SplatState.load(tmp_path / "splat.npz").step < 24
    resumed = fit_splat(model, None, schedule, saved=tmp_path / "splat.npz")
    assert np.array_equal(resumed.table, whole.table)
    again = fit_splat(model, None, schedule, saved=tmp_path / "splat.npz")
    assert np.array_equal(again.table, whole.table)
    states = (SplatState.load(tmp_path / name) for name in ("whole.npz", "splat.npz"))
    for one, other in zip(*(vars(state).values() for state in states), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_loss_and_its_gradient_are_torchs(rng):
    picture = rng.random((3, 37, 29)).astype(np.float32)
    photo = np.clip(picture + 0.1 * rng.normal(size=picture.shape), 0, 1).astype(np.float32)
    restored = picture_loss(picture, photo)
    x = torch.tensor(picture.astype(np.float64), requires_grad=True)
    y = torch.tensor(photo.astype(np.float64))
    line = torch.exp(-0.5 * (torch.arange(-5, 6, dtype=torch.float64) / 1.5) ** 2)
    window = torch.outer(line, line).expand(3, 1, 11, 11) / line.sum() ** 2

    def mean(maps: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(maps[None], window, padding=5, groups=3)[0]

    mx, my = mean(x), mean(y)
    sx, sy, sxy = mean(x * x) - mx * mx, mean(y * y) - my * my, mean(x * y) - mx * my
    similarity = (2 * mx * my + 1e-4) * (2 * sxy + 9e-4) / ((mx * mx + my * my + 1e-4) * (sx + sy + 9e-4))
    loss = 0.8 * (x - y).abs().mean() + 0.2 * (1 - similarity.mean())
    loss.backward()
    assert ssim(picture, photo) == pytest.approx(similarity.mean().item(), rel=1e-5)
    assert restored.value == pytest.approx(loss.item(), rel=1e-5)
    assert np.abs(restored.gradient - x.grad.numpy()).max() < 1e-4 * np.abs(x.grad.numpy()).max()
    assert psnr(picture, picture + np.float32(0.1)) == pytest.approx(20, abs=1e-3)


def test_adam_is_torchs(rng):
    table = rng.normal(size=(6, 4)).astype(np.float32)
    slopes = rng.normal(size=(5, 6, 4)).astype(np.float32)
    rates = np.array([1e-2, 2e-2, 1e-3, 0], np.float32)
    true = torch.tensor(table)
    columns = [torch.nn.Parameter(true[:, c].clone()) for c in range(4)]
    adam = torch.optim.Adam([{"params": [p], "lr": float(r)} for p, r in zip(columns, rates, strict=True)], eps=1e-15)
    state = SplatState.beginning(table)
    for slope in slopes:
        for c, column in enumerate(columns):
            column.grad = torch.tensor(slope[:, c])
        adam.step()
        assert not adam_step(state, slope, rates).any()
    assert np.allclose(table, torch.stack(columns, dim=1).detach().numpy(), atol=1e-6)
    assert state.step == 5


def test_gaussians_without_a_finite_gradient_are_discarded_and_counted(orbit, rng, monkeypatch):
    def with_nan(drawing, gradient, *, width):
        restored = gradients_of(drawing, gradient, width=width)
        restored.table[:2, 0] = np.nan, -np.inf
        return restored

    monkeypatch.setattr("dynamictree.reconstruct.optimise.gradients_of", with_nan)
    fit = fit_splat(small_model(orbit, rng), None, replace(SMALL, num_steps=20))
    assert fit.figures["num_gaussians_discarded"] == 40  # two in every step
    assert np.isfinite(fit.table).all()
    assert (cloud_of(fit.table).opacity[:2] < 1e-6).all()


def points_table(rng: np.random.Generator, number: int, size: float) -> np.ndarray:
    points, colors = rng.normal(size=(number, 3)).astype(np.float32), np.full((number, 3), 0.5, np.float32)
    return table_of_points(points, colors, np.full(number, size, np.float32), opacity=0.5, sh_degree=1)


def pulled(table: np.ndarray, pull: np.ndarray) -> SplatState:
    """A state in which one view pulled at each Gaussian so much."""
    state = SplatState.beginning(table)
    state.pull[0], state.pull[1] = pull, 1
    return state


def test_the_large_are_split_the_small_get_twins_the_faint_go(rng):
    table = points_table(rng, 4, 0.001)
    table[1, LOG_SCALE] = np.log(0.05)
    table[2, LOGIT] = -9
    table[3, LOG_SCALE] = np.log(0.5)
    state = pulled(table, np.array([1, 1, 1, 0]))
    densify(state, DensityRules(), extent=1.0, rng=rng)
    after = state.table
    assert len(after) == len(state.first) == 4  # the first and its twin, two halves
    assert np.array_equal(after[0], after[1])
    assert np.array_equal(after[0], table[0])
    assert np.allclose(np.exp(after[2:, LOG_SCALE]), 0.05 / 1.6)
    assert not np.allclose(after[2, MEAN], after[3, MEAN])


def test_the_budget_goes_to_those_that_are_pulled_at_most_and_to_the_subject_first(rng):
    table = points_table(rng, 10, 0.001)
    table[:, MEAN] = np.where(np.arange(10)[:, None] == 3, 0.5, 2.0)
    state, rules = pulled(table, np.arange(10)), DensityRules(max_gaussians=12)
    densify(state, rules, extent=1.0, rng=rng)
    assert len(state.table) == 12
    assert {tuple(row) for row in state.table[10:].tolist()} == {tuple(row) for row in table[[9, 3]].tolist()}
    state.pull[:] = 1
    densify(state, rules, extent=1.0, rng=rng)
    assert len(state.table) == 12


@pytest.mark.parametrize(("number", "expected"), [(14, [3, 10]), (5, [1, 3]), (32, [4, 12, 20, 28])])
def test_photos_are_held_out_all_along_the_walk(number, expected):
    assert held_out_views(number) == expected


def test_points_are_thinned_evenly_in_space(rng):
    points = np.concatenate([rng.normal(scale=0.01, size=(5000, 3)), rng.uniform(-1, 1, (500, 3))])
    thinned_points = subsample(points, 300, rng)
    assert 200 < len(thinned_points) <= 300
    assert (thinned_points < 5000).sum() < 30
    assert len(subsample(points[:100], 300, rng)) == 100
