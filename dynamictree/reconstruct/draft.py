"""Preview of the splat during reconstruction: first the sparse points, then the Gaussians optimised so far."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from dynamictree.files import atomic_file
from dynamictree.formats.splat.ply import UP_AXIS
from dynamictree.formats.splat.splat import write_splat
from dynamictree.reconstruct.splat_start import point_spacing, subsample
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import LOG_SCALE, LOGIT, MEAN, cloud_of, table_of_points
from dynamictree.reconstruct.views import SparseModel

OnFile = Callable[[Path], None]
DRAFT = "draft.splat"
EVERY_S = 20.0
_OPAQUE_LOGIT = np.float32(2)


@dataclass(kw_only=True)
class Draft:
    """Writer of previews: small splats around the subject, upright, of unknown scale; each replaces the one before."""

    folder: Path
    on_file: OnFile
    _written_at: float = field(default=-np.inf, init=False)

    def show_points(self, model: SparseModel) -> None:
        """Write the points of structure from motion; the model is in the upright frame."""
        least_points = 4  # fewest points with a spacing
        most_points = 20_000
        rows = subsample(model.points, most_points, np.random.default_rng(0))
        points, colors = model.points[rows].astype(np.float32), model.colors[rows] / np.float32(255)
        if len(points) >= least_points:
            self._write(table_of_points(points, colors, point_spacing(points), opacity=0.9, sh_degree=0))

    def show(self, state: SplatState) -> None:
        """Write the Gaussians after an optimisation step, unless the last preview is younger than `EVERY_S`."""
        table = state.table
        if state.step > 0 and time.monotonic() - self._written_at < EVERY_S:
            return
        if state.step == 0:  # the optimisation starts with nearly transparent Gaussians
            table = table.copy()
            table[:, LOGIT] = np.maximum(table[:, LOGIT], _OPAQUE_LOGIT)
        self._write(table)

    def delete(self) -> None:
        """Delete the preview, once the result exists."""
        (self.folder / DRAFT).unlink(missing_ok=True)

    def _write(self, table: Float32[np.ndarray, "G P"]) -> None:
        widest = 0.3  # share of the region's radius
        subject = 1.2  # share of the region's radius; Gaussians farther away are background
        near = np.linalg.norm(table[:, MEAN], axis=1) < subject
        table = table[near & (table[:, LOG_SCALE].max(axis=1) < np.log(widest))]
        if len(table) == 0:
            return
        path = self.folder / DRAFT
        with atomic_file(path) as stream:
            cloud = cloud_of(table)
            upright = replace(cloud.source, up_axis=UP_AXIS)  # a .splat file cannot state another axis
            write_splat(replace(cloud, source=upright), stream)
        self._written_at = time.monotonic()
        self.on_file(path)
