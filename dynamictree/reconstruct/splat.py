"""Fit a splat to photos, with regular checkpoints; held-out photos evaluate the result."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from dynamictree.gaussian.cuda import has_gsplat
from dynamictree.reconstruct.depth import DepthMaps
from dynamictree.reconstruct.optimise import Schedule, SplatTask, Target, downscaled, on_black, optimise, render_target
from dynamictree.reconstruct.picture_loss import psnr, ssim
from dynamictree.reconstruct.result import SplatFigures
from dynamictree.reconstruct.sky import Foreground
from dynamictree.reconstruct.splat_start import initial_table, sky_table
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.views import SparseModel, View, nearest_pixels

_INSIDE = 0.5  # least alpha


class SplatFit(NamedTuple):
    """Gaussians in the frame of the model, and their quality."""

    table: Float32[np.ndarray, "G P"]
    figures: SplatFigures


def held_out_views(number: int) -> list[int]:
    """Choose an eighth of the photos, at least two, evenly spaced, without the first and last."""
    one_in = 8  # photos is held out
    count = max(2, number // one_in)
    return [int((place + 0.5) * number / count) for place in range(count)]


def fit_splat(
    model: SparseModel,
    depths: DepthMaps | None,
    schedule: Schedule,
    *,
    sky: Sequence[Foreground] | None = None,
    saved: Path | None = None,
    on_state: Callable[[SplatState], None] = lambda state: None,
) -> SplatFit:
    """Fit Gaussians to all photos except those held out, which evaluate the result.

    Args:
        model: views and points in the upright frame.
        depths: depth maps of the same views, if there are any; those of held-out photos are not used.
        schedule: number of steps, picture sizes and learning rates.
        sky: photos without their sky, if they show any; Gaussians of sky are added behind the result.
        saved: file for the state, written every 20 s and when `on_state` raises; the run continues from it.
        on_state: called with the state every quarter of a second; its exceptions propagate.
    """
    save_every_s, report_every_s = 20.0, 0.25
    start_gaussians = 25_000
    held_out_rows = held_out_views(len(model.views))
    learned = [view for view in range(len(model.views)) if view not in held_out_rows]
    table = initial_table(
        replace(model, views=tuple(model.views[view] for view in learned)),
        None if depths is None else _some_depths(depths, learned),
        sky=None if sky is None else [sky[view] for view in learned],
        number=min(start_gaussians, schedule.rules.max_gaussians // 2),
        sh_degree=schedule.sh_degree,
        rng=np.random.default_rng(0),
    )
    state = SplatState.load(saved) if saved is not None and saved.exists() else SplatState.beginning(table)
    saved_at, reported_at = time.monotonic(), -np.inf

    def on_step(state: SplatState) -> None:
        nonlocal saved_at, reported_at
        now = time.monotonic()
        if saved is not None and now - saved_at > save_every_s:
            state.save(saved)
            saved_at = now
        if now - reported_at > report_every_s:
            reported_at = now
            try:
                on_state(state)
            except BaseException:
                if saved is not None:
                    state.save(saved)
                raise

    def target(view: int, depth: Float32[np.ndarray, "h w"] | None) -> Target:
        return _target(model.views[view], depth, None if sky is None else sky[view])

    around = np.array([view.camera.position_m for view in model.views])
    around -= around.mean(axis=0)
    task = SplatTask(
        targets=(target(view, None if depths is None else depths.depths[view]) for view in learned),
        held_out=(target(view, None) for view in held_out_rows),
        extent=1.1 * float(np.linalg.norm(around, axis=1).max()),  # the scene extent of Kerbl et al.
        cut_out=any(view.alpha is not None for view in model.views),
    )
    if has_gsplat():
        from dynamictree.reconstruct.optimise_on_gpu import optimise_on_gpu  # torch and gsplat

        optimise_on_gpu(state, task, schedule, on_step)
    else:
        optimise(state, task, schedule, on_step)
    if saved is not None:
        state.save(saved)
    table = state.table
    if sky is not None:
        behind = sky_table([model.views[view] for view in learned], [sky[view] for view in learned], schedule.sh_degree)
        table = np.concatenate([table, behind])
    figures = _figures(state, table, [model.views[view] for view in held_out_rows], schedule)
    return SplatFit(table, figures)


def _figures(
    state: SplatState, table: Float32[np.ndarray, "G P"], held_out: list[View], schedule: Schedule
) -> SplatFigures:
    targets = [downscaled(_target(view, None, None), schedule.side_px) for view in held_out]
    pairs = [(render_target(table, target, schedule.sh_degree), on_black(target)) for target in targets]
    inside = [None if target.alpha is None else target.alpha > _INSIDE for target in targets]
    masked = [
        (picture[mask], photo[mask]) for (picture, photo), mask in zip(pairs, inside, strict=True) if mask is not None
    ]
    blank = [(np.broadcast_to(photo.mean(axis=(0, 1)), photo.shape), photo) for _, photo in pairs]
    psnr_db, masked_db, blank_db = ([round(psnr(*pair), 2) for pair in each] for each in (pairs, masked, blank))
    height, width = pairs[0][1].shape[:2]
    return SplatFigures(
        held_out=[view.source for view in held_out],
        held_out_psnr_db=psnr_db,
        held_out_masked_psnr_db=masked_db,
        held_out_ssim=[round(ssim(*np.ascontiguousarray(np.moveaxis(np.stack(pair), 3, 1))), 4) for pair in pairs],
        held_out_blank_psnr_db=blank_db,
        held_out_size_px=[width, height],
        splat_steps=state.step,
        num_gaussians_discarded=state.num_discarded,
    )


def _target(view: View, depth: Float32[np.ndarray, "h w"] | None, sky: Foreground | None) -> Target:
    source = view if sky is None else sky
    photo = source.image.astype(np.float32) / 255
    alpha = None if source.alpha is None else source.alpha.astype(np.float32) / 255
    depth = None if depth is None else nearest_pixels(depth, *photo.shape[:2])
    return Target(camera=view.camera, photo=photo, alpha=alpha, depth=depth)


def _some_depths(depths: DepthMaps, chosen: list[int]) -> DepthMaps:
    return DepthMaps(views=[depths.views[view] for view in chosen], depths=[depths.depths[view] for view in chosen])
