"""Region of the subject and depth maps of the photos, in a frame with +Z up."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynamictree.photo_requests import QUALITIES
from dynamictree.reconstruct.depth import DepthMaps, find_depths, load_depths, outside_sky, save_depths
from dynamictree.reconstruct.fusion import Box, above, fuse, main_cluster
from dynamictree.reconstruct.sky import Foreground, without_sky
from dynamictree.reconstruct.stage import find_stage
from dynamictree.reconstruct.views import SparseModel

LEAST_FACES = 200  # of a surface
GAP = 0.06  # of the region's radius: pieces nearer to one another belong together


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Cameras and depth maps in the stage's frame."""

    model: SparseModel  # all views
    matched: SparseModel  # those of the depth maps
    depths: DepthMaps
    subject: Box | None  # around what the depths show of it; None with masks, or where they show nothing
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
    """Find up, match all views, and find the subject in their depths.

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
        depths, subject = load_depths(matched, saved)
    else:
        depths = find_depths(matched, lambda done, total: on_progress(done / total))
        subject = None if cut_out else _subject(depths, cut)
        if saved is not None:
            save_depths(depths, subject, saved)
    sky = None if cut_out else without_sky(matched.views, depths.depths)
    if sky is not None:
        depths = outside_sky(depths, sky)
    on_progress(1.0)
    return Scene(
        model=model, matched=matched, depths=depths, subject=subject, cut=cut, ground_found=stage.ground_found, sky=sky
    )


def _subject(depths: DepthMaps, cut: float) -> Box | None:
    """The box around the main thing above the ground; None where too little is seen of it."""
    box_margin = 0.08  # of the shape's extent: thin ends have no depth
    voxels = 128  # along the longest side
    region = Box(low=np.array([-1.0, -1.0, -0.1]), high=np.array([1.0, 1.0, 2.0]))
    surface = main_cluster(above(fuse(depths.views, depths.depths, region, resolution=voxels), cut), GAP)
    if len(surface.faces) < LEAST_FACES:
        return None
    low, high = (corner(surface.vertices, axis=0).astype(np.float64) for corner in (np.min, np.max))
    margin = box_margin * float((high - low).max())
    return Box(low=low - margin, high=high + margin)


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
