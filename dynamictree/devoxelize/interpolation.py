"""Interpolation from the voxels of a grid to points, prepared once and applied to any values."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float32, Int32, Shaped

from dynamictree.devoxelize.attachment import Attachments
from dynamictree.devoxelize.surface_fit import SurfaceFit


@dataclass(frozen=True, kw_only=True)
class VoxelInterpolation:
    """Weights from voxels to the points of one mesh.

    `rows` and `weights` are the voxels that each point depends on; the weights are not negative and sum to 1, or
    are all 0 for what stands still. With a
    `fit`, a value is not the weighted mean of the values of voxels, but that of the smoothest motion with these means.
    """

    rows: Int32[np.ndarray, "N M"]  # into the grid's coords
    weights: Float32[np.ndarray, "N M"]
    num_voxels: int
    fit: SurfaceFit | None = None
    fitted: Int32[np.ndarray, " N"] | None = None  # of the fit's vertices the one that each point is
    attachments: Attachments | None = None  # of the fit's vertices
    still: Bool[np.ndarray, " N"] | None = None  # points that get no value: what is no plant

    def apply(self, values: Shaped[np.ndarray, "V ..."]) -> Shaped[np.ndarray, "N ..."]:
        """Values at voxels to values at points, single precision, real or complex."""
        flat = np.ascontiguousarray(values).reshape(self.num_voxels, -1)
        parts = flat.view(np.float32) if flat.dtype == np.complex64 else flat.astype(np.float32, copy=False)
        result = self.mean(parts) if self.fit is None else self.fit.solve(parts)[self.fitted]  # [N, D]
        if self.still is not None:
            result[self.still] = 0
        whole = np.ascontiguousarray(result).view(np.complex64 if flat.dtype == np.complex64 else np.float32)
        return whole.reshape(len(self.rows), *values.shape[1:])

    def mean(self, values: Float32[np.ndarray, "V D"]) -> Float32[np.ndarray, "N D"]:
        """The weighted mean of the values at each point's voxels, without the fit."""
        num_points, width = self.rows.shape
        ends = np.arange(0, num_points * width + 1, width)
        matrix = scipy.sparse.csr_array(
            (self.weights.ravel(), self.rows.ravel(), ends), shape=(num_points, self.num_voxels)
        )
        return np.asarray(matrix @ values)
