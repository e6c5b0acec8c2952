"""Gaussians as a table of parameters, one row each, and back to a cloud."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float32

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.parallel import compiled
from dynamictree.reconstruct.gradient import Shapes

MEAN, QUATERNION, LOG_SCALE, LOGIT = slice(0, 3), slice(3, 7), slice(7, 10), 10
COLOR, REST = slice(11, 14), 14
"""Columns; harmonics follow one another, three channels each."""


def table_of_points(
    points: Float32[np.ndarray, "G 3"],
    colors: Float32[np.ndarray, "G 3"],
    sizes: Float32[np.ndarray, " G"],
    *,
    opacity: float,
    sh_degree: int,
) -> Float32[np.ndarray, "G P"]:
    """Round Gaussians at points; colours are display colours in [0, 1], sizes standard deviations."""
    table = np.zeros((len(points), REST - 3 + 3 * (sh_degree + 1) ** 2), np.float32)
    table[:, MEAN] = points
    table[:, QUATERNION.start] = 1
    table[:, LOG_SCALE] = np.log(sizes)[:, None]
    table[:, LOGIT] = np.log(opacity / (1 - opacity))
    table[:, COLOR] = (colors - 0.5) / SH_0
    return table


def shapes_of(table: Float32[np.ndarray, "G P"], sh_degree: int) -> Shapes:
    """Convert the table for the renderer, with harmonics up to a degree; its quaternions are unit ones."""
    num_harmonics = (sh_degree + 1) ** 2
    sh = table[:, COLOR.start : COLOR.start + 3 * num_harmonics].reshape(len(table), num_harmonics, 3)
    return Shapes(
        means=np.ascontiguousarray(table[:, MEAN]),
        quaternions=np.ascontiguousarray(table[:, QUATERNION]),
        scales=np.exp(table[:, LOG_SCALE]),
        opacity=_sigmoid(table[:, LOGIT]),
        sh=np.ascontiguousarray(sh),
    )


def cloud_of(table: Float32[np.ndarray, "G P"]) -> GaussianCloud:
    """The same as a cloud."""
    shapes = shapes_of(table, round(((table.shape[1] - COLOR.start) / 3) ** 0.5) - 1)
    return GaussianCloud(
        means=shapes.means, quaternions=shapes.quaternions, scales=shapes.scales, opacity=shapes.opacity, sh=shapes.sh
    )


def unit_quaternions(table: Float32[np.ndarray, "G P"]) -> None:
    """Make the quaternions of a table unit ones, in place."""
    _make_unit(0, len(table), table)


@compiled
@no_type_check
def _make_unit(first, end, table):
    for g in range(first, end):
        q = table[g, 3:7]
        length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        for c in range(4):
            q[c] /= length


def _sigmoid(x: Float32[np.ndarray, " G"]) -> Float32[np.ndarray, " G"]:
    result: Float32[np.ndarray, " G"] = 1 / (1 + np.exp(-x))
    return result
