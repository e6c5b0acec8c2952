"""Convert between Gaussians and a table of their optimised parameters, one row per Gaussian."""

import numpy as np
from jaxtyping import Float32

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0

MEAN, QUATERNION, LOG_SCALE, LOGIT = slice(0, 3), slice(3, 7), slice(7, 10), 10
COLOR, REST = slice(11, 14), 14
"""Columns; harmonics are consecutive, with three channels each."""


def table_of_points(
    points: Float32[np.ndarray, "G 3"],
    colors: Float32[np.ndarray, "G 3"],
    sizes: Float32[np.ndarray, " G"],
    *,
    opacity: float,
    sh_degree: int,
) -> Float32[np.ndarray, "G P"]:
    """Create isotropic Gaussians at points; colours are display colours in [0, 1], sizes standard deviations."""
    table = np.zeros((len(points), REST - 3 + 3 * (sh_degree + 1) ** 2), np.float32)
    table[:, MEAN] = points
    table[:, QUATERNION.start] = 1
    table[:, LOG_SCALE] = np.log(sizes)[:, None]
    table[:, LOGIT] = np.log(opacity / (1 - opacity))
    table[:, COLOR] = (colors - 0.5) / SH_0
    return table


def cloud_of(table: Float32[np.ndarray, "G P"], sh_degree: int | None = None) -> GaussianCloud:
    """Convert a table with unit quaternions to a cloud, with harmonics up to a degree (by default all)."""
    num_harmonics = (table.shape[1] - COLOR.start) // 3 if sh_degree is None else (sh_degree + 1) ** 2
    sh = table[:, COLOR.start : COLOR.start + 3 * num_harmonics].reshape(len(table), num_harmonics, 3)
    return GaussianCloud(
        means=np.ascontiguousarray(table[:, MEAN]),
        quaternions=np.ascontiguousarray(table[:, QUATERNION]),
        scales=np.exp(table[:, LOG_SCALE]),
        opacity=1 / (1 + np.exp(-table[:, LOGIT])),
        sh=np.ascontiguousarray(sh),
    )
