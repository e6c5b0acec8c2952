"""Gaussians that a mesh shows."""

import numpy as np
from jaxtyping import Bool
from scipy.spatial import cKDTree

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh

BESIDE = 0.02  # of the region's radius: how far from the mesh a Gaussian of it may stand
_LARGEST = 0.15  # of the region's radius: what is wider belongs to the background
_FAINTEST = 0.02


def of_the_mesh(cloud: GaussianCloud, mesh: TriangleMesh, *, radius: float) -> Bool[np.ndarray, " G"]:
    """Select Gaussians near the mesh that are neither wide nor faint; `radius` is that of the region."""
    distance = cKDTree(mesh.vertices).query(cloud.means, distance_upper_bound=BESIDE * radius)[0]
    narrow = cloud.scales.max(axis=1) < _LARGEST * radius
    chosen: Bool[np.ndarray, " G"] = np.isfinite(distance) & narrow & (cloud.opacity > _FAINTEST)
    return chosen
