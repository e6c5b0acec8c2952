"""Optimisation of Gaussians against the photos. Kerbl et al. 2023, with a schedule for two cores.

Coarse to fine: the first steps see small pictures, which cost little; Mip-Splatting's filter makes what is learned
there hold at every size. Some photos choose: the best picture of them ends the work early.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float32, Float64
from PIL import Image

from dynamictree.reconstruct.adam import AdamState, AdamStep, adam_step
from dynamictree.reconstruct.densify import DensityRules, Pull, before_cameras, densified, fainter
from dynamictree.reconstruct.gradient import draw, gradients_of
from dynamictree.reconstruct.picture_loss import SSIM_SHARE, picture_loss, psnr
from dynamictree.reconstruct.splat_table import LOG_SCALE, LOGIT, MEAN, QUATERNION, REST, shapes_of, unit_quaternions
from dynamictree.render.camera import Camera

_DISCARDED_LOGIT = np.float32(-20)  # not drawn, and pruned by the next densification


@dataclass(frozen=True, kw_only=True)
class Target:
    """A photo to be matched, and its camera."""

    camera: Camera
    photo: Float32[np.ndarray, "H W 3"]  # display space, in [0, 1]
    alpha: Float32[np.ndarray, "H W"] | None = None  # where given, the photo is cut out by it
    depth: Float32[np.ndarray, "H W"] | None = None  # 0 where unknown


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Steps, sizes and learning rates. Steps are a tenth of Kerbl et al.'s, so rates are theirs times 2 to 20."""

    num_steps: int = 3000
    side_px: int = 640  # of the finest pictures
    coarser: tuple[tuple[float, int], ...] = ((0.15, 4), (0.45, 2))  # until this share of the steps, smaller by this
    position_rates: tuple[float, float] = (3.2e-4, 3.2e-6)  # of the extent, first and last; theirs times 2
    cut_out_position_rates: tuple[float, float] = (1.6e-3, 3.2e-5)  # the same for photos that are cut out
    color_rate: float = 1e-2  # theirs times 4
    opacity_rate: float = 0.1  # theirs times 2
    scale_rate: float = 2e-2  # theirs times 4
    turn_rate: float = 4e-3  # theirs times 4
    sh_degree: int = 1
    degree_every: int = 300  # steps, until one more is used
    densify: tuple[float, float] = (0.1, 0.7)  # between these shares of the steps
    densify_every: int = 100
    reset_at: float | None = None  # share of the steps; so few steps never make up for one (measured)
    depth_share: float = 0.1  # of the loss, at first; falls to a hundredth of it
    rules: DensityRules = field(default_factory=DensityRules)
    cut_out_min_opacity: float = 0.02  # below it a Gaussian is pruned, where photos are cut out
    check_every: int = 250
    patience: int = 3  # checks at full size without a better picture, until it ends


@dataclass(frozen=True, kw_only=True)
class SplatProgress:
    """State of the optimisation: enough to continue it."""

    table: Float32[np.ndarray, "G P"]
    moments: AdamState
    step: int
    pull: Pull | None = None  # since Gaussians were last made
    best_psnr: float = -np.inf  # of the choosing photos, at full size
    best: Float32[np.ndarray, "B P"] | None = None
    num_discarded: int = 0  # Gaussians whose gradient was not finite
    checks: tuple[tuple[int, int, float], ...] = ()  # step, number of Gaussians, PSNR of the choosing photos [dB]

    @property
    def result(self) -> Float32[np.ndarray, "R P"]:
        """Gaussians with the best PSNR of the choosing photos, or the last ones."""
        return self.table if self.best is None else self.best


def optimise(
    start: SplatProgress,
    targets: Sequence[Target],
    choosing: Sequence[Target],
    schedule: Schedule,
    *,
    extent: float,
    cut_out: bool = False,
    cameras: Float64[np.ndarray, "V 3"] | None = None,
    on_step: Callable[[SplatProgress], None] = lambda progress: None,
) -> SplatProgress:
    """Optimise, split and prune Gaussians; `on_step` may save the state, or raise to stop.

    Photos that are `cut_out` show the subject alone, by masks. Where `cameras` were is free space, also where those of
    other photos were.
    """
    levels = _Levels(targets, choosing, schedule)
    pull = start.pull or Pull(len(start.table))
    progress = replace(start, pull=pull)
    while progress.step < schedule.num_steps and not _worn_out(progress, schedule):
        on_step(progress)
        rng = np.random.default_rng([1, progress.step])
        shrink = _shrink(schedule, progress.step)
        target = levels.target(progress.step, shrink)
        degree = min(schedule.sh_degree, progress.step // schedule.degree_every)
        stepped = _one_step(progress, target, pull, schedule, degree=degree, extent=extent, cut_out=cut_out, rng=rng)
        num_discarded = progress.num_discarded + int(stepped.skipped.sum())
        progress = replace(progress, moments=stepped.state, step=progress.step + 1, num_discarded=num_discarded)
        if choosing and progress.step % schedule.check_every == 0:
            progress = _checked(progress, levels, schedule, degree)
        share = progress.step / schedule.num_steps
        if schedule.densify[0] <= share < schedule.densify[1] and progress.step % schedule.densify_every == 0:
            rules = _rules(schedule, shrink, cut_out=cut_out)
            if cameras is not None:
                progress.table[before_cameras(progress.table, cameras, rules), LOGIT] = _DISCARDED_LOGIT
            table, moments = densified(progress.table, progress.moments, pull.mean, rules, extent=extent, rng=rng)
            pull = Pull(len(table))
            progress = replace(progress, table=table, moments=moments, pull=pull)
        if schedule.reset_at is not None and progress.step == round(schedule.reset_at * schedule.num_steps):
            fainter(progress.table, progress.moments)
    return progress


def _one_step(
    progress: SplatProgress,
    target: Target,
    pull: Pull,
    schedule: Schedule,
    *,
    degree: int,
    extent: float,
    cut_out: bool,
    rng: np.random.Generator,
) -> AdamStep:
    height, width = target.photo.shape[:2]
    drawing = draw(shapes_of(progress.table, degree), target.camera, width=width, height=height)
    behind = rng.random(3, np.float32) if target.alpha is not None else np.zeros(3, np.float32)
    wanted = target.photo
    if target.alpha is not None:
        wanted = target.photo * target.alpha[..., None] + behind * (1 - target.alpha[..., None])
    light = drawing.picture[..., 4]
    composited = drawing.picture[..., :3] + behind * light[..., None]
    loss = picture_loss(planes_of(composited), planes_of(wanted), ssim_share=SSIM_SHARE)
    gradient = np.zeros_like(drawing.picture)
    gradient[..., :3] = loss.gradient.transpose(1, 2, 0)
    gradient[..., 4] = gradient[..., :3] @ behind
    if target.depth is not None and schedule.depth_share > 0:
        share = schedule.depth_share * 0.01 ** (progress.step / schedule.num_steps)
        _add_depth(gradient, drawing.picture, target.depth, share)
    gradients = gradients_of(drawing, gradient, width=progress.table.shape[1])
    seen = drawing.bounds[:, 1] > drawing.bounds[:, 0]
    pull.add(gradients.centres_px, seen, width, height)
    rates = _rates(schedule, progress.step, progress.table.shape[1], extent, cut_out=cut_out)
    stepped = adam_step(progress.table, gradients.table, progress.moments, rates)
    progress.table[stepped.skipped, LOGIT] = _DISCARDED_LOGIT
    unit_quaternions(progress.table)
    return stepped


def _add_depth(
    gradient: Float32[np.ndarray, "H W 5"],
    picture: Float32[np.ndarray, "H W 5"],
    depth: Float32[np.ndarray, "H W"],
    share: float,
) -> None:
    """Gradient of the mean relative error of depth where one is known: Σ w (z − z*) / z*, so opacity is left alone."""
    measured = depth > 0
    per = np.where(measured, 1 / np.where(measured, depth, 1), 0).astype(np.float32)
    error = picture[..., 3] * per - (1 - picture[..., 4]) * measured
    slope = np.sign(error) * np.float32(share / max(measured.sum(), 1))
    gradient[..., 3] += slope * per
    gradient[..., 4] += slope * measured


def _rules(schedule: Schedule, shrink: int, *, cut_out: bool) -> DensityRules:
    rules = replace(schedule.rules, max_gaussians=schedule.rules.max_gaussians // shrink)
    return replace(rules, min_opacity=schedule.cut_out_min_opacity) if cut_out else rules


def _rates(schedule: Schedule, step: int, width: int, extent: float, *, cut_out: bool) -> Float32[np.ndarray, " P"]:
    first, last = schedule.cut_out_position_rates if cut_out else schedule.position_rates
    rates = np.full(width, schedule.color_rate, np.float32)
    rates[REST:] /= 20
    rates[MEAN] = extent * first * (last / first) ** (step / schedule.num_steps)
    rates[QUATERNION], rates[LOG_SCALE], rates[LOGIT] = schedule.turn_rate, schedule.scale_rate, schedule.opacity_rate
    return rates


def _shrink(schedule: Schedule, step: int) -> int:
    share = step / schedule.num_steps
    return next((smaller for until, smaller in schedule.coarser if share < until), 1)


def _worn_out(progress: SplatProgress, schedule: Schedule) -> bool:
    """Whether the last checks at full size were all worse than an earlier one."""
    full = [value for step, _, value in progress.checks if _shrink(schedule, step - 1) == 1]
    since = len(full) - 1 - int(np.argmax(full)) if full else 0
    return since >= schedule.patience


def _checked(progress: SplatProgress, levels: "_Levels", schedule: Schedule, degree: int) -> SplatProgress:
    psnr_db = mean_psnr(progress.table, levels.choosing, degree)
    progress = replace(progress, checks=(*progress.checks, (progress.step, len(progress.table), psnr_db)))
    if _shrink(schedule, progress.step) > 1 or psnr_db <= progress.best_psnr:
        return progress
    return replace(progress, best_psnr=psnr_db, best=progress.table.copy())


def mean_psnr(table: Float32[np.ndarray, "G P"], targets: Sequence[Target], sh_degree: int) -> float:
    """Mean over the photos [dB]."""
    return float(np.mean([psnr(drawn(table, target, sh_degree), on_black(target)) for target in targets]))


def drawn(table: Float32[np.ndarray, "G P"], target: Target, sh_degree: int) -> Float32[np.ndarray, "H W 3"]:
    """Render the Gaussians for a target, on black."""
    height, width = target.photo.shape[:2]
    picture = draw(shapes_of(table, sh_degree), target.camera, width=width, height=height).picture
    result: Float32[np.ndarray, "H W 3"] = np.clip(picture[..., :3], 0, 1)
    return result


def on_black(target: Target) -> Float32[np.ndarray, "H W 3"]:
    """The target's photo on black."""
    return target.photo if target.alpha is None else target.photo * target.alpha[..., None]


def planes_of(picture: Float32[np.ndarray, "H W 3"]) -> Float32[np.ndarray, "3 H W"]:
    """A picture as one plane a channel."""
    return np.ascontiguousarray(picture.transpose(2, 0, 1))


class _Levels:
    """The photos at every size that is used, and which comes next: each once, then in another order."""

    def __init__(self, targets: Sequence[Target], choosing: Sequence[Target], schedule: Schedule) -> None:
        self.choosing = [smaller(target, schedule.side_px) for target in choosing]
        sides = {1: schedule.side_px, **{by: schedule.side_px // by for _, by in schedule.coarser}}
        self._targets = {by: [smaller(target, side) for target in targets] for by, side in sides.items()}

    def target(self, step: int, shrink: int) -> Target:
        targets = self._targets[shrink]
        turn, place = divmod(step, len(targets))
        return targets[int(np.random.default_rng([2, turn]).permutation(len(targets))[place])]


def smaller(target: Target, side_px: int) -> Target:
    """Reduce a target to at most `side_px` pixels per side."""
    height, width = target.photo.shape[:2]
    by = min(1.0, side_px / max(height, width))
    if by == 1:
        return target
    size = (round(width * by), round(height * by))
    channels = [_resized(target.photo[..., c], size) for c in range(3)]
    alpha = None if target.alpha is None else _resized(target.alpha, size)
    depth = None if target.depth is None else _nearest(target.depth, size)
    return replace(target, photo=np.stack(channels, axis=2), alpha=alpha, depth=depth)


def _resized(plane: Float32[np.ndarray, "H W"], size: tuple[int, int]) -> Float32[np.ndarray, "h w"]:
    picture = Image.fromarray(np.ascontiguousarray(plane)).resize(size, Image.Resampling.BOX)
    return np.array(picture, np.float32)


def _nearest(plane: Float32[np.ndarray, "H W"], size: tuple[int, int]) -> Float32[np.ndarray, "h w"]:
    rows = (np.arange(size[1]) * plane.shape[0]) // size[1]
    columns = (np.arange(size[0]) * plane.shape[1]) // size[0]
    return np.ascontiguousarray(plane[np.ix_(rows, columns)])
