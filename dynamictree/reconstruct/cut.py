"""Separate the tree's Gaussians from the scene, and convert to metres."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.spatial import cKDTree

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.reconstruct.splat_table import cloud_of

BESIDE = 0.02  # of the region's radius: how far from the mesh a Gaussian of the tree may stand
_LARGEST = 0.15  # of the region's radius: what is wider belongs to the background
_FAINTEST = 0.02


def cloud_in_metres(table: Float32[np.ndarray, "G P"], scale: float, origin: Float64[np.ndarray, "3"]) -> GaussianCloud:
    """Convert Gaussians from the stage's frame to metres."""
    cloud = cloud_of(table)
    means = (scale * (cloud.means - origin)).astype(np.float32)
    return replace(cloud, means=means, scales=(cloud.scales * np.float32(scale)))


def of_the_tree(
    cloud: GaussianCloud, vertices: Float32[np.ndarray, "N 3"], *, radius_m: float
) -> Bool[np.ndarray, " G"]:
    """Select Gaussians near the mesh's vertices that are neither wide nor faint; the radius is the region's [m]."""
    distance = cKDTree(vertices).query(cloud.means, distance_upper_bound=BESIDE * radius_m)[0]
    narrow = cloud.scales.max(axis=1) < _LARGEST * radius_m
    chosen: Bool[np.ndarray, " G"] = np.isfinite(distance) & narrow & (cloud.opacity > _FAINTEST)
    return chosen
