"""The splat so far, for those who wait: first the points that the cameras share, then what is learned from them."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from dynamictree.files import replacing
from dynamictree.formats.splat.ply import UP_AXIS
from dynamictree.formats.splat.splat import write_splat
from dynamictree.reconstruct.splat_start import spacing, thinned
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import LOG_SCALE, LOGIT, MEAN, cloud_of, table_of_points
from dynamictree.reconstruct.views import SparseModel

OnFile = Callable[[Path], None]
DRAFT = "draft.splat"
EVERY_S = 20.0
_OPAQUE_LOGIT = np.float32(2)


@dataclass(kw_only=True)
class Draft:
    """A small splat of the region around the subject, upright and of unknown size; each takes the last one's place."""

    folder: Path
    on_file: OnFile
    _written_at: float = field(default=-np.inf, init=False)

    def show_points(self, model: SparseModel) -> None:
        """Show the points that the photos share; the model is in the stage's frame."""
        least_points = 4  # that have neighbours
        most_points = 20_000
        rows = thinned(model.points, most_points, np.random.default_rng(0))
        points, colors = model.points[rows].astype(np.float32), model.colors[rows] / np.float32(255)
        if len(points) >= least_points:
            self._write(table_of_points(points, colors, spacing(points), opacity=0.9, sh_degree=0))

    def show(self, state: SplatState) -> None:
        """Show Gaussians after a step of learning, unless the last ones are younger than `EVERY_S`."""
        table = state.table
        if state.step > 0 and time.monotonic() - self._written_at < EVERY_S:
            return
        if state.step == 0:  # learning begins with a mist
            table = table.copy()
            table[:, LOGIT] = np.maximum(table[:, LOGIT], _OPAQUE_LOGIT)
        self._write(table)

    def delete(self) -> None:
        """Delete the file: the result has taken its place."""
        (self.folder / DRAFT).unlink(missing_ok=True)

    def _write(self, table: Float32[np.ndarray, "G P"]) -> None:
        widest = 0.3  # of the region's radius
        subject = 1.2  # of the region's radius: what is farther away is background
        near = np.linalg.norm(table[:, MEAN], axis=1) < subject
        table = table[near & (table[:, LOG_SCALE].max(axis=1) < np.log(widest))]
        if len(table) == 0:
            return
        path = self.folder / DRAFT
        with replacing(path) as stream:
            cloud = cloud_of(table)
            upright = replace(cloud.source, up_axis=UP_AXIS)  # a .splat file cannot say another axis
            write_splat(replace(cloud, source=upright), stream)
        self._written_at = time.monotonic()
        self.on_file(path)
