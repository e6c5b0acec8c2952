"""Convert clouds from a file's axes and unit to metres and +Z up, and back."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import turn_sh
from dynamictree.rotation import matrix_quaternions, quaternion_products
from dynamictree.up_axis import up_rotation


def to_z_up(cloud: GaussianCloud, *, up_axis: str, unit_m: float) -> GaussianCloud:
    """Convert a cloud from its file's axes and unit to metres and +Z up.

    Raises:
        InputError: the axis is unknown, or the unit is not a positive length.
    """
    if not (np.isfinite(unit_m) and unit_m > 0):
        raise InputError(f"unit_m is {unit_m}; it must be positive and finite")
    turned = transform_cloud(cloud, up_rotation(up_axis), unit_m)
    return replace(turned, source=replace(turned.source, up_axis=up_axis, scale=unit_m))


def to_source_axes(cloud: GaussianCloud, up_axis: str | None = None) -> GaussianCloud:
    """Undo `to_z_up`, so that files we write match the capture; `up_axis` is that of a format with a fixed one."""
    return transform_cloud(cloud, up_rotation(up_axis or cloud.source.up_axis).T, 1 / cloud.source.scale)


def transform_cloud(cloud: GaussianCloud, rotation: Float64[np.ndarray, "3 3"], scale: float) -> GaussianCloud:
    """Rotate a cloud with its harmonics, then scale it about the origin."""
    if scale == 1 and np.array_equal(rotation, np.eye(3)):
        return cloud
    return replace(
        cloud,
        means=(cloud.means @ rotation.T * scale).astype(np.float32),
        quaternions=quaternion_products(matrix_quaternions(rotation[None]).astype(np.float32), cloud.quaternions),
        scales=(cloud.scales * scale).astype(np.float32),
        sh=turn_sh(cloud.sh, rotation),
    )
