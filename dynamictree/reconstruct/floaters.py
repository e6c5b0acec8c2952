"""Floaters: faint Gaussians in the air, and strays, which learning leaves around a plant."""

import numpy as np
from jaxtyping import Bool
from scipy.spatial import cKDTree

from dynamictree.gaussian.cloud import GaussianCloud

_OPAQUE, _LEAST_OPAQUE = 0.5, 0.2  # what is no floater; of the plant's Gaussians
_TOGETHER, _STRAY = 8, 3.0  # the opaque ones that tell how dense they lie; times the usual distance: strays
_BESIDE = 0.5  # of that distance


def faint_floaters(cloud: GaussianCloud, own: Bool[np.ndarray, " G"]) -> Bool[np.ndarray, " G"]:
    """Which of the chosen Gaussians hang in the air around the plant: faint ones away from all opaque ones, and strays.

    Learning leaves them before a textured background that it shows not quite right. Where few are opaque, none is one.
    """
    rows = np.flatnonzero(own)
    floaters = np.zeros(cloud.num_gaussians, np.bool_)
    opaque = rows[cloud.opacity[rows] > _OPAQUE]
    if len(opaque) < max(_TOGETHER, _LEAST_OPAQUE * len(rows)):
        return floaters
    spacing = np.asarray(cKDTree(cloud.means[opaque]).query(cloud.means[opaque], k=_TOGETHER)[0])[:, -1]
    usual = float(np.median(spacing))
    body = opaque[spacing <= _STRAY * usual]
    floaters[rows] = cKDTree(cloud.means[body]).query(cloud.means[rows])[0] > _BESIDE * usual
    return floaters
