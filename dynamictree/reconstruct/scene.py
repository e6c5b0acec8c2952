"""Region of the subject and depth maps of the photos, in a frame with +Z up."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynamictree.photo_requests import QUALITIES
from dynamictree.reconstruct.depth import DepthMaps, coarse_depths, fine_depths, load_depths, outside_sky, save_depths
from dynamictree.reconstruct.fusion import Box, above, fuse, main_cluster
from dynamictree.reconstruct.sky import Foreground, without_sky
from dynamictree.reconstruct.stage import find_stage
from dynamictree.reconstruct.views import SparseModel

LEAST_FACES = 200  # of a surface
GAP = 0.06  # of the region's radius: pieces nearer to one another belong together


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Cameras and depth maps in the stage's frame, and the box around the subject."""

    model: SparseModel  # all views
    matched: SparseModel  # those of the depth maps
    coarse: DepthMaps
    fine: DepthMaps | None  # only for rays that meet the box; None with masks, or where the coarse ones show nothing
    box: Box  # around the subject
    cut: float  # height below which is ground
    ground_found: bool
    sky: list[Foreground] | None = None  # of the matched views, where they show one


def find_scene(
    model: SparseModel,
    *,
    max_views: int = QUALITIES["standard"].max_views,
    saved: Path | None = None,
    on_model: Callable[[SparseModel], None] = lambda model: None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Scene:
    """Find up and the subject, and match all views: coarse depths locate the subject, fine ones are of it alone.

    Where photos show sky, its depths are left out: stereo gives it those of the leaves before it.

    Args:
        model: as structure from motion gives it.
        max_views: that are matched, evenly chosen: bounds time and memory.
        saved: a file for the depth maps; those of an earlier call with the same model are read from it.
        on_model: gets the model in the stage's frame before the views are matched.
        on_progress: gets the share that is done; what it raises passes through.
    """
    ground_cut = 0.02  # of the region's radius: lower parts count as ground
    cut_out = all(view.alpha is not None for view in model.views)
    stage = find_stage(model, np.random.default_rng(0), ground=not cut_out)
    model = model.transformed(1 / stage.radius, stage.rotation, stage.origin)
    on_model(model)
    matched = _evenly_chosen(model, max_views)
    cut = ground_cut if stage.ground_found else -np.inf
    if saved is not None and saved.exists():
        coarse, fine, box = load_depths(matched, saved)
    else:
        coarse, fine, box = _depths(matched, cut, on_progress)
        if saved is not None:
            save_depths(coarse, fine, box, saved)
    sky = None if cut_out else without_sky(matched.views, coarse.depths)
    if sky is not None:
        coarse, fine = outside_sky(coarse, sky), None if fine is None else outside_sky(fine, sky)
    on_progress(1.0)
    return Scene(
        model=model,
        matched=matched,
        coarse=coarse,
        fine=fine,
        box=box,
        cut=cut,
        ground_found=stage.ground_found,
        sky=sky,
    )


def _depths(
    matched: SparseModel, cut: float, on_progress: Callable[[float], None]
) -> tuple[DepthMaps, DepthMaps | None, Box]:
    """Coarse and fine depths and the subject's box; with masks no fine ones, stereo would leave out parts of it."""
    box_margin = 0.08  # of the coarse shape's extent: thin ends show in the fine maps only
    coarse_voxels = 128  # along the longest side
    coarse, matches = coarse_depths(matched, lambda done, total: on_progress(0.5 * done / total))
    cut_out = all(view.alpha is not None for view in matched.views)
    region = Box(low=np.array([-1.0, -1.0, -1.0 if cut_out else -0.1]), high=np.array([1.0, 1.0, 2.0]))
    if cut_out:
        return coarse, None, region
    subject = main_cluster(above(fuse(coarse.views, coarse.depths, region, resolution=coarse_voxels), cut), GAP)
    if len(subject.faces) < LEAST_FACES:
        return coarse, None, region
    box = Box(low=subject.vertices.min(axis=0).astype(np.float64), high=subject.vertices.max(axis=0).astype(np.float64))
    box = box.padded(box_margin * float((box.high - box.low).max()))
    return coarse, fine_depths(matched, matches, box, lambda done, total: on_progress(0.5 + 0.5 * done / total)), box


def _evenly_chosen(model: SparseModel, max_views: int) -> SparseModel:
    number = len(model.views)
    if number <= max_views:
        return model
    chosen = np.linspace(0, number - 1, max_views).round().astype(int)
    row_of = np.full(number, -1)
    row_of[chosen] = np.arange(len(chosen))
    seen = model.seen[row_of[model.seen[:, 0]] >= 0]
    seen = np.stack([row_of[seen[:, 0]], seen[:, 1]], axis=1)
    return replace(model, views=tuple(model.views[view] for view in chosen), seen=seen)
