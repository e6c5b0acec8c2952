"""Gaussians that a mesh shows."""

import numpy as np
from jaxtyping import Bool
from scipy.spatial import cKDTree

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh

BESIDE = 0.02  # of the region's radius: how far from the mesh a Gaussian of it may stand


def of_the_mesh(cloud: GaussianCloud, mesh: TriangleMesh, *, radius: float) -> Bool[np.ndarray, " G"]:
    """Select Gaussians near the mesh that are neither wide nor faint; `radius` is that of the region."""
    faintest = 0.02
    largest = 0.15  # of the region's radius: what is wider belongs to the background
    distance = cKDTree(mesh.vertices).query(cloud.means, distance_upper_bound=BESIDE * radius)[0]
    narrow = cloud.scales.max(axis=1) < largest * radius
    chosen: Bool[np.ndarray, " G"] = np.isfinite(distance) & narrow & (cloud.opacity > faintest)
    return chosen
