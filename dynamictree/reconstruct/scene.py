"""Scene of the photos in a frame with +Z up: cameras, depth maps and the subject's box."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynamictree.photo_requests import QUALITIES
from dynamictree.reconstruct.depth import DepthMaps, find_depths, load_depths, outside_sky, save_depths
from dynamictree.reconstruct.fusion import Box, faces_above, fuse, main_cluster
from dynamictree.reconstruct.photo_cameras import evenly_chosen
from dynamictree.reconstruct.sky import Foreground, without_sky
from dynamictree.reconstruct.upright_frame import find_upright_frame
from dynamictree.reconstruct.views import SparseModel

LEAST_FACES = 200  # faces of a surface
CLUSTER_GAP = 0.06  # share of the region's radius; pieces closer together belong together


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Cameras and depth maps in the upright frame."""

    model: SparseModel  # all views
    matched: SparseModel  # views of the depth maps
    depths: DepthMaps
    subject: Box | None  # bounds in the depth maps; None with masks, or if they show no subject
    cut: float  # height; everything below is ground
    ground_found: bool
    sky: list[Foreground] | None = None  # matched views without sky, if they show any


def find_scene(
    model: SparseModel,
    *,
    max_views: int = QUALITIES["standard"].max_views,
    saved: Path | None = None,
    on_model: Callable[[SparseModel], None] = lambda model: None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Scene:
    """Find the vertical, compute depth maps by stereo, and find the subject in them.

    Depths of sky are left out, since stereo assigns it the depth of leaves in front of it.

    Args:
        model: result of structure from motion.
        max_views: number of views to match, evenly chosen; bounds time and memory.
        saved: file for the depth maps; if it exists, it is read, and must be of the same model.
        on_model: called with the model in the upright frame, before stereo.
        on_progress: called with the completed share; its exceptions propagate.
    """
    ground_cut = 0.02  # share of the region's radius; lower parts count as ground
    cut_out = all(view.alpha is not None for view in model.views)
    frame = find_upright_frame(model, np.random.default_rng(0), ground=not cut_out)
    model = model.transformed(1 / frame.radius, frame.rotation, frame.origin)
    on_model(model)
    matched = _evenly_chosen(model, max_views)
    cut = ground_cut if frame.ground_found else -np.inf
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
        model=model, matched=matched, depths=depths, subject=subject, cut=cut, ground_found=frame.ground_found, sky=sky
    )


def _subject(depths: DepthMaps, cut: float) -> Box | None:
    """Return the box of the main object above the ground; None if too little of it is visible."""
    box_margin = 0.08  # share of the shape's extent, since thin ends have no depth
    voxels = 128  # number along the longest side
    region = Box(low=np.array([-1.0, -1.0, -0.1]), high=np.array([1.0, 1.0, 2.0]))
    surface = main_cluster(faces_above(fuse(depths.views, depths.depths, region, resolution=voxels), cut), CLUSTER_GAP)
    if len(surface.faces) < LEAST_FACES:
        return None
    low, high = (corner(surface.vertices, axis=0).astype(np.float64) for corner in (np.min, np.max))
    margin = box_margin * float((high - low).max())
    return Box(low=low - margin, high=high + margin)


def _evenly_chosen(model: SparseModel, max_views: int) -> SparseModel:
    chosen = evenly_chosen(range(len(model.views)), max_views)
    row_of = np.full(len(model.views), -1)
    row_of[chosen] = np.arange(len(chosen))
    seen = model.seen[row_of[model.seen[:, 0]] >= 0]
    seen = np.stack([row_of[seen[:, 0]], seen[:, 1]], axis=1)
    return replace(model, views=tuple(model.views[view] for view in chosen), seen=seen)
