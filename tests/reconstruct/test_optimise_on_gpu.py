"""The GPU's trainer at its seams: the slow renderer stands in for gsplat, the CPU for the device."""

import importlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch

from dynamictree.gaussian.cuda import has_gsplat
from dynamictree.reconstruct.optimise import Schedule, SplatTask, Target, mean_psnr, render_target
from dynamictree.reconstruct.picture_loss import picture_loss
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import LOGIT, MEAN, table_of_points
from dynamictree.render.camera import Camera
from tests.gaussian.slow_splat import Leaves, draw_slowly

TRAINER = "dynamictree.reconstruct.optimise_on_gpu"
WIDTH, HEIGHT = 24, 20
CAMERAS = [
    Camera.look_at(2.5 * np.array([np.sin(turn), -np.cos(turn), 0.3]), np.zeros(3)) for turn in np.linspace(0, 1.2, 4)
]
SCHEDULE = Schedule(num_steps=4, side_px=WIDTH, check_every=2, sh_degree=1, degree_every=2)


@dataclass
class FakeStrategy:
    """Makes no Gaussians, and counts its calls."""

    cap_max: int
    refine_start_iter: int
    refine_stop_iter: int
    min_opacity: float
    steps: int = 0

    def check_sanity(self, params: Any, optimizers: dict[str, torch.optim.Optimizer]) -> None:
        assert set(params) == set(optimizers) >= {"means", "scales", "quats", "opacities"}
        assert all(len(optimizer.param_groups) == 1 for optimizer in optimizers.values())

    def initialize_state(self) -> dict[str, Any]:
        return {}

    def step_post_backward(
        self, params: Any, optimizers: Any, state: Any, step: int, information: dict[str, Any], lr: float
    ) -> None:
        assert params["means"].grad is None
        assert information == {"width": WIDTH}
        assert lr > 0
        self.steps += 1


def fake_rasterization(**given: Any) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """gsplat's signature and shapes, by the slow renderer."""
    assert given["packed"] is False
    assert given["rasterize_mode"] == "antialiased"
    pose, matrix = given["viewmats"][0].numpy().astype(float), given["Ks"][0].numpy().astype(float)
    width, height = given["width"], given["height"]
    camera = Camera(
        position_m=-pose[:3, :3].T @ pose[:3, 3],
        world_to_camera=pose[:3, :3],
        focal=matrix[0, 0] / height,
        centre=(matrix[0, 2] / width, matrix[1, 2] / height),
    )
    leaves = Leaves(
        means=given["means"].double(),
        quaternions=given["quats"].double(),
        log_scales=given["scales"].double().log(),
        logit_opacity=given["opacities"].double().logit(),
        sh=given["colors"][:, : (given["sh_degree"] + 1) ** 2].double(),
    )
    picture = draw_slowly(leaves, camera, width=width, height=height).float()
    return picture[None, ..., :3], 1 - picture[None, ..., 4:], {"width": width}


@pytest.fixture
def trainer(monkeypatch) -> Iterator[Any]:
    fake = ModuleType("gsplat")
    fake.rasterization, fake.MCMCStrategy = fake_rasterization, FakeStrategy
    monkeypatch.setitem(sys.modules, "gsplat", fake)
    yield importlib.import_module(TRAINER)
    sys.modules.pop(TRAINER)  # it has the stand-in


def table_of(rng: np.random.Generator, number: int = 30) -> np.ndarray:
    points = rng.uniform(-0.4, 0.4, (number, 3)).astype(np.float32)
    colors = rng.random((number, 3)).astype(np.float32)
    return table_of_points(points, colors, np.full(number, 0.15, np.float32), opacity=0.6, sh_degree=1)


@pytest.fixture
def task(rng) -> SplatTask:
    """Photos of Gaussians, cut out; the last one is held out."""
    truth = table_of(rng)
    targets = [Target(camera=camera, photo=np.zeros((HEIGHT, WIDTH, 3), np.float32)) for camera in CAMERAS]
    targets = [replace(target, photo=render_target(truth, target, 1)) for target in targets]
    return SplatTask(targets=targets[:3], held_out=targets[3:], extent=2.5)


def test_it_learns_what_photos_show(trainer: Any, task: SplatTask, rng) -> None:
    state = SplatState.beginning(table_of(rng))
    before = mean_psnr(state.table, task.targets, 1)
    seen: list[int] = []
    trainer.optimise_on_gpu(state, task, SCHEDULE, lambda state: seen.append(state.step), device="cpu")
    assert seen == [0, 1, 2, 3]
    assert state.step == 4
    assert mean_psnr(state.table, task.targets, 1) > before + 1
    assert state.checks[:, 0].tolist() == [2, 4]
    assert state.checks[-1, 2] == pytest.approx(mean_psnr(state.table, task.held_out, 1), abs=0.01)


def test_what_is_cut_out_stands_before_any_colour(trainer: Any, task: SplatTask, rng) -> None:
    """Gaussians outside of the masks fade, whatever the photos show there."""
    nothing = [replace(target, alpha=np.zeros((HEIGHT, WIDTH), np.float32)) for target in task.targets]
    state = SplatState.beginning(table_of(rng))
    opacity = state.table[:, LOGIT].mean()
    trainer.optimise_on_gpu(state, replace(task, targets=nothing, held_out=()), SCHEDULE, device="cpu")
    assert state.table[:, LOGIT].mean() < opacity - 0.5


def test_a_stop_leaves_a_state_that_goes_on(trainer: Any, task: SplatTask, rng) -> None:
    state = SplatState.beginning(table_of(rng))
    start = state.table[:, MEAN].copy()

    def stop(state: SplatState) -> None:
        if state.step == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trainer.optimise_on_gpu(state, task, SCHEDULE, stop, device="cpu")
    assert state.step == 2
    assert np.abs(state.table[:, MEAN] - start).max() > 0
    trainer.optimise_on_gpu(state, task, SCHEDULE, device="cpu")
    assert state.step == 4


def test_its_loss_is_that_of_the_cpu(trainer: Any, rng) -> None:
    picture, photo = rng.random((2, 3, 37, 29)).astype(np.float32)
    loss = trainer._loss(torch.from_numpy(picture), torch.from_numpy(photo))
    assert loss.item() == pytest.approx(picture_loss(picture, photo).value, rel=1e-5)


@pytest.mark.gpu
def test_gsplat_learns_what_photos_show(task: SplatTask, rng) -> None:
    if not has_gsplat():
        pytest.skip("gsplat or a CUDA device is not there")
    optimise_on_gpu = importlib.import_module(TRAINER).optimise_on_gpu
    state = SplatState.beginning(table_of(rng))
    before = mean_psnr(state.table, task.targets, 1)
    optimise_on_gpu(state, task, replace(SCHEDULE, num_steps=100))
    assert mean_psnr(state.table, task.targets, 1) > before + 3
