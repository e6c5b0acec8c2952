"""Fit a splat to the photos, and save the state regularly.

Some photos are held out and judge the result; others, which are not learned from either, choose the best state of it.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from dynamictree.reconstruct.adam import AdamState
from dynamictree.reconstruct.checkpoint import load_progress, save_progress
from dynamictree.reconstruct.depth import DepthMaps
from dynamictree.reconstruct.optimise import (
    Schedule,
    SplatProgress,
    Target,
    drawn,
    on_black,
    optimise,
    planes_of,
    smaller,
)
from dynamictree.reconstruct.picture_loss import psnr, ssim
from dynamictree.reconstruct.sky import Foreground
from dynamictree.reconstruct.splat_start import first_table, sky_table
from dynamictree.reconstruct.views import SparseModel, View

START_GAUSSIANS = 25_000
_INSIDE = 0.5  # alpha
_ONE_IN = 8  # photos is held out, and two at least
_CHOOSES_ONE_IN = 16  # and one at least
_SAVE_EVERY_S, _REPORT_EVERY_S = 20.0, 0.25


@dataclass(frozen=True, kw_only=True)
class SplatFit:
    """Result of the fit, in the frame of the model."""

    table: Float32[np.ndarray, "G P"]
    held_out: tuple[str, ...]  # photos, by their own names
    chosen_by: tuple[str, ...]  # photos that chose the best state
    psnr_db: tuple[float, ...]  # of each of them
    masked_db: tuple[float, ...]  # PSNR inside the mask; none without masks
    ssim: tuple[float, ...]
    blank_db: tuple[float, ...]  # of a picture of one colour, the photo's mean, beside it
    size_px: tuple[int, int]  # width and height of the first
    num_steps: int
    num_discarded: int  # Gaussians whose gradient was not finite
    checks: tuple[tuple[int, int, float], ...]  # by the photos that choose


def held_out_views(number: int) -> list[int]:
    """Every eighth of the photos and at least two, spread over the walk, neither the first nor the last."""
    count = max(2, number // _ONE_IN)
    return [int((place + 0.5) * number / count) for place in range(count)]


def choosing_views(number: int) -> list[int]:
    """One in 16 of the photos and at least one, each in the middle between two that are held out."""
    held_out = held_out_views(number)
    between = [(first + second) // 2 for first, second in pairwise(held_out)]
    count = min(max(1, number // _CHOOSES_ONE_IN), len(between))
    return [between[int((place + 0.5) * len(between) / count)] for place in range(count)]


def fit_splat(
    model: SparseModel,
    depths: DepthMaps | None,
    schedule: Schedule,
    *,
    sky: Sequence[Foreground] | None = None,
    saved: Path | None = None,
    on_progress: Callable[[float, float | None], None] = lambda share, psnr_db: None,
    on_table: Callable[[Float32[np.ndarray, "G P"], int], None] = lambda table, step: None,
) -> SplatFit:
    """Fit Gaussians to all photos but those that choose the best state, and those held out, which judge it.

    Args:
        model: in the stage's frame.
        depths: of the same views, where stereo has some; only those of photos that are learned from are used.
        schedule: how long and how fine.
        sky: the photos without their sky, where they show one; it is put behind what was learned.
        saved: a file for the state, every 20 s and when `on_progress` raises; the run continues from it if it exists.
        on_progress: gets the share that is done and the PSNR [dB] of the choosing photos at the last check, every
            quarter of a second; what it raises passes through.
        on_table: gets the Gaussians and the number of steps behind them as often.
    """
    held_out_rows = held_out_views(len(model.views))
    choosing_rows = choosing_views(len(model.views))
    learned = [view for view in range(len(model.views)) if view not in {*held_out_rows, *choosing_rows}]
    cut = any(view.alpha is not None for view in model.views)
    table = first_table(
        _some_views(model, learned),
        None if depths is None else _some_depths(depths, learned),
        sky=None if sky is None else [sky[view] for view in learned],
        number=min(START_GAUSSIANS, schedule.rules.max_gaussians // 2),
        sh_degree=schedule.sh_degree,
        dome=not cut,
        rng=np.random.default_rng(0),
    )
    start = SplatProgress(table=table, moments=AdamState.fresh(*table.shape), step=0)
    if saved is not None and saved.exists():
        start = load_progress(saved)
    saved_at = reported_at = time.monotonic()

    def step(progress: SplatProgress) -> None:
        nonlocal saved_at, reported_at
        now = time.monotonic()
        if saved is not None and now - saved_at > _SAVE_EVERY_S:
            save_progress(progress, saved)
            saved_at = now
        if now - reported_at > _REPORT_EVERY_S or progress.step == start.step:
            reported_at = now
            try:
                on_progress(progress.step / schedule.num_steps, progress.checks[-1][2] if progress.checks else None)
                on_table(progress.table, progress.step)
            except BaseException:
                if saved is not None:
                    save_progress(progress, saved)
                raise

    def target(view: int, depth: Float32[np.ndarray, "h w"] | None) -> Target:
        return _target(model.views[view], depth, None if sky is None else sky[view])

    targets = [target(view, None if depths is None else depths.depths[view]) for view in learned]
    choosing = [target(view, None) for view in choosing_rows]
    cameras = np.array([view.camera.position_m for view in model.views])
    extent = camera_extent(model.views)
    end = optimise(start, targets, choosing, schedule, extent=extent, cut_out=cut, cameras=cameras, on_step=step)
    if saved is not None:
        save_progress(end, saved)
    table = end.result
    if sky is not None:
        behind = sky_table([model.views[view] for view in learned], [sky[view] for view in learned], schedule.sh_degree)
        table = np.concatenate([table, behind])
    fit = _judged(end, table, [model.views[view] for view in held_out_rows], schedule)
    return replace(fit, chosen_by=tuple(model.views[view].source for view in choosing_rows))


def camera_extent(views: Sequence[View]) -> float:
    """Kerbl et al.'s measure of a scene: 1.1 times the largest distance of a camera from their middle."""
    positions = np.array([view.camera.position_m for view in views])
    return 1.1 * float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())


def _judged(end: SplatProgress, table: Float32[np.ndarray, "G P"], views: list[View], schedule: Schedule) -> SplatFit:
    targets = [smaller(_target(view, None, None), schedule.side_px) for view in views]
    pictures = [drawn(table, target, schedule.sh_degree) for target in targets]
    photos = [on_black(target) for target in targets]
    return SplatFit(
        table=table,
        held_out=tuple(view.source for view in views),
        chosen_by=(),
        psnr_db=tuple(psnr(picture, photo) for picture, photo in zip(pictures, photos, strict=True)),
        masked_db=tuple(
            psnr(picture[target.alpha > _INSIDE], photo[target.alpha > _INSIDE])
            for picture, photo, target in zip(pictures, photos, targets, strict=True)
            if target.alpha is not None
        ),
        ssim=tuple(ssim(planes_of(picture), planes_of(photo)) for picture, photo in zip(pictures, photos, strict=True)),
        blank_db=tuple(psnr(np.broadcast_to(photo.mean(axis=(0, 1)), photo.shape), photo) for photo in photos),
        size_px=(photos[0].shape[1], photos[0].shape[0]),
        num_steps=end.step,
        num_discarded=end.num_discarded,
        checks=end.checks,
    )


def _target(view: View, depth: Float32[np.ndarray, "h w"] | None, sky: Foreground | None) -> Target:
    if sky is None:
        photo = view.image.astype(np.float32) / 255
        alpha = None if view.alpha is None else view.alpha.astype(np.float32) / 255
    else:
        photo, alpha = sky.color, sky.cover
    if depth is None:
        return Target(camera=view.camera, photo=photo, alpha=alpha)
    height, width = photo.shape[:2]
    rows, columns = (np.arange(height) * depth.shape[0]) // height, (np.arange(width) * depth.shape[1]) // width
    return Target(camera=view.camera, photo=photo, alpha=alpha, depth=depth[np.ix_(rows, columns)])


def _some_views(model: SparseModel, chosen: list[int]) -> SparseModel:
    return replace(model, views=tuple(model.views[view] for view in chosen))


def _some_depths(depths: DepthMaps, chosen: list[int]) -> DepthMaps:
    return replace(
        depths, views=[depths.views[view] for view in chosen], depths=[depths.depths[view] for view in chosen]
    )
