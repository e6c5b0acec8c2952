"""Optimisation of Gaussians against photos: Kerbl et al. 2023, with a schedule for two CPU cores.

Coarse to fine: the first steps use small pictures, which cost little; Mip-Splatting's filter makes their result valid
at every size.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float32

from dynamictree.gaussian.rasterize import draw
from dynamictree.reconstruct.adam import adam_step
from dynamictree.reconstruct.densify import DensityRules, densify
from dynamictree.reconstruct.gradient import gradients_of
from dynamictree.reconstruct.picture_loss import SSIM_SHARE, picture_loss, psnr
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import LOG_SCALE, LOGIT, MEAN, QUATERNION, REST, cloud_of
from dynamictree.reconstruct.views import nearest_pixels, resized
from dynamictree.render.camera import Camera

_DISCARDED_LOGIT = np.float32(-20)  # logit of Gaussians that are not drawn, and pruned by the next densification


@dataclass(frozen=True, kw_only=True)
class Target:
    """Photo to be matched, with its camera."""

    camera: Camera
    photo: Float32[np.ndarray, "H W 3"]  # display space, [0, 1]
    alpha: Float32[np.ndarray, "H W"] | None = None  # mask that cuts the photo out
    depth: Float32[np.ndarray, "H W"] | None = None  # depth, 0 where unknown


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Steps, sizes and learning rates. Steps are a tenth of Kerbl et al.'s, so rates are theirs times 2 to 20."""

    num_steps: int = 3000
    side_px: int = 640  # long side of the finest pictures
    coarser: tuple[tuple[float, int], ...] = ((0.15, 4), (0.45, 2))  # up to this share of the steps, reduced by
    position_rates: tuple[float, float] = (3.2e-4, 3.2e-6)  # [extent], first and last; 2 times Kerbl et al.'s
    cut_out_position_rates: tuple[float, float] = (1.6e-3, 3.2e-6)  # the same for photos with masks
    color_rate: float = 1e-2  # 4 times Kerbl et al.'s
    opacity_rate: float = 0.1  # 2 times Kerbl et al.'s
    scale_rate: float = 2e-2  # 4 times Kerbl et al.'s
    turn_rate: float = 4e-3  # 4 times Kerbl et al.'s
    sh_degree: int = 1
    degree_every: int = 300  # steps between increases of the degree
    densify: tuple[float, float] = (0.1, 0.7)  # first and last share of the steps
    densify_every: int = 100
    depth_share: float = 0.1  # initial weight in the loss; falls to a hundredth
    rules: DensityRules = field(default_factory=DensityRules)
    cut_out_min_opacity: float = 0.02  # `min_opacity` for photos with masks
    check_every: int = 250  # steps between evaluations on the held-out photos


@dataclass(frozen=True, kw_only=True)
class SplatTask:
    """Photos that Gaussians are fitted to and evaluated on."""

    targets: Iterable[Target]  # iterated once: all photos at full size would take gigabytes
    held_out: Iterable[Target]  # photos for evaluation only
    extent: float  # size of the cameras' region
    cut_out: bool = False  # photos have masks and show the subject alone


def optimise(
    state: SplatState, task: SplatTask, schedule: Schedule, on_step: Callable[[SplatState], None] = lambda state: None
) -> None:
    """Optimise and densify Gaussians in place; `on_step` may save the state, or raise to stop."""
    levels = _Levels(task, schedule)
    while state.step < schedule.num_steps:
        on_step(state)
        rng = np.random.default_rng([1, state.step])
        share = state.step / schedule.num_steps
        shrink = next((smaller for until, smaller in schedule.coarser if share < until), 1)
        degree = min(schedule.sh_degree, state.step // schedule.degree_every)
        _one_step(state, levels.target(state.step, shrink), task, schedule, degree, rng)
        if levels.held_out and state.step % schedule.check_every == 0:
            psnr_db = mean_psnr(state.table, levels.held_out, degree)
            state.checks = np.concatenate([state.checks, [[state.step, len(state.table), psnr_db]]])
        share = state.step / schedule.num_steps
        if schedule.densify[0] <= share < schedule.densify[1] and state.step % schedule.densify_every == 0:
            densify(state, _rules(schedule, share, cut_out=task.cut_out), extent=task.extent, rng=rng)


def _one_step(
    state: SplatState, target: Target, task: SplatTask, schedule: Schedule, degree: int, rng: np.random.Generator
) -> None:
    height, width = target.photo.shape[:2]
    drawing = draw(cloud_of(state.table, degree), target.camera, width=width, height=height)
    behind = rng.random(3, np.float32) if target.alpha is not None else np.zeros(3, np.float32)
    photo = target.photo if target.alpha is None else behind + target.alpha[..., None] * (target.photo - behind)
    rendered = drawing.picture[..., :3] + behind * drawing.picture[..., 4:]
    planes = (np.ascontiguousarray(image.transpose(2, 0, 1)) for image in (rendered, photo))
    loss = picture_loss(*planes, ssim_share=SSIM_SHARE)
    depth_share = schedule.depth_share * 0.01 ** (state.step / schedule.num_steps)
    gradient = _loss_gradient(drawing.picture, loss.gradient, behind, target.depth, depth_share)
    gradients = gradients_of(drawing, gradient, width=state.table.shape[1])
    half_size = np.array([0.5 * width, 0.5 * height], np.float32)
    state.pull[0] += np.hypot(*(half_size * gradients.centres_px).T)
    state.pull[1] += drawing.bounds[:, 1] > drawing.bounds[:, 0]
    skipped = adam_step(state, gradients.table, _rates(schedule, state, task))
    state.num_discarded += int(skipped.sum())
    state.table[skipped, LOGIT] = _DISCARDED_LOGIT
    turns = state.table[:, QUATERNION]
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)


def _loss_gradient(
    picture: Float32[np.ndarray, "H W 5"],
    loss: Float32[np.ndarray, "3 H W"],
    behind: Float32[np.ndarray, "3"],
    depth: Float32[np.ndarray, "H W"] | None,
    share: float,
) -> Float32[np.ndarray, "H W 5"]:
    """Compute the loss's gradient by the drawn picture: that of the planes, plus that of the mean relative depth error.

    The depth error is Σ w (z − z*) / z*, where z* is known; it leaves opacity alone.
    """
    gradient = np.zeros_like(picture)
    gradient[..., :3] = loss.transpose(1, 2, 0)
    gradient[..., 4] = gradient[..., :3] @ behind
    if depth is not None and (seen := depth > 0).any():
        z, mean_depth = depth[seen], picture[seen, 3]
        slope = np.float32(share / len(z)) * np.sign(mean_depth / z - (1 - picture[seen, 4]))
        gradient[seen, 3] = slope / z
        gradient[seen, 4] += slope
    return gradient


def _rules(schedule: Schedule, share: float, *, cut_out: bool) -> DensityRules:
    rules = replace(schedule.rules, max_gaussians=int(schedule.rules.max_gaussians * share / schedule.densify[1]))
    return replace(rules, min_opacity=schedule.cut_out_min_opacity) if cut_out else rules


def _rates(schedule: Schedule, state: SplatState, task: SplatTask) -> Float32[np.ndarray, " P"]:
    first, last = schedule.cut_out_position_rates if task.cut_out else schedule.position_rates
    rates = np.full(state.table.shape[1], schedule.color_rate, np.float32)
    rates[REST:] /= 20
    rates[MEAN] = task.extent * first * (last / first) ** (state.step / schedule.num_steps)
    rates[QUATERNION], rates[LOG_SCALE], rates[LOGIT] = schedule.turn_rate, schedule.scale_rate, schedule.opacity_rate
    return rates


def mean_psnr(table: Float32[np.ndarray, "G P"], targets: Sequence[Target], sh_degree: int) -> float:
    """Return the mean PSNR over the photos [dB]."""
    return float(np.mean([psnr(render_target(table, target, sh_degree), on_black(target)) for target in targets]))


def render_target(table: Float32[np.ndarray, "G P"], target: Target, sh_degree: int) -> Float32[np.ndarray, "H W 3"]:
    """Render the Gaussians for a target, on black."""
    height, width = target.photo.shape[:2]
    picture = draw(cloud_of(table, sh_degree), target.camera, width=width, height=height).picture
    result: Float32[np.ndarray, "H W 3"] = np.clip(picture[..., :3], 0, 1)
    return result


def on_black(target: Target) -> Float32[np.ndarray, "H W 3"]:
    """Return the target's photo, on black where it has a mask."""
    return target.photo if target.alpha is None else target.photo * target.alpha[..., None]


class _Levels:
    """Photos at every size of the schedule, in random order, shuffled anew after each epoch."""

    def __init__(self, task: SplatTask, schedule: Schedule) -> None:
        self.held_out = [downscaled(target, schedule.side_px) for target in task.held_out]
        sides = {1: schedule.side_px, **{by: schedule.side_px // by for _, by in schedule.coarser}}
        self._targets: dict[int, list[Target]] = {by: [] for by in sides}
        for target in task.targets:
            for by, side in sides.items():
                self._targets[by].append(downscaled(target, side))

    def target(self, step: int, shrink: int) -> Target:
        targets = self._targets[shrink]
        turn, place = divmod(step, len(targets))
        return targets[int(np.random.default_rng([2, turn]).permutation(len(targets))[place])]


def downscaled(target: Target, side_px: int) -> Target:
    """Reduce a target to at most `side_px` pixels per side."""
    height, width = target.photo.shape[:2]
    by = min(1.0, side_px / max(height, width))
    if by == 1:
        return target
    size = (round(width * by), round(height * by))
    channels = [resized(target.photo[..., c], size) for c in range(3)]
    alpha = None if target.alpha is None else resized(target.alpha, size)
    depth = None if target.depth is None else nearest_pixels(target.depth, *size[::-1])
    return replace(target, photo=np.stack(channels, axis=2), alpha=alpha, depth=depth)
