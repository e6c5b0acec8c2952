"""Size of captures: scans are in metres, the scale of a splat is arbitrary."""

from dataclasses import replace

import numpy as np

from dynamictree.gaussian.axes import transformed
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import SourceWarning
from dynamictree.plant.axes import scale_to, size_warnings

DEFAULT_HEIGHT_M = 5.0
"""Of a splat whose file does not say its unit."""
_STRAYS = 0.002  # of the Gaussians at each end, which may lie far out


def sized(
    cloud: GaussianCloud, *, height_m: float | None, stated: bool
) -> tuple[GaussianCloud, tuple[SourceWarning, ...]]:
    """Scale a cloud to a height, or to the default where its unit is not known; and say what is doubtful."""
    detected = cloud_height(cloud)
    if height_m is None and (stated or detected == 0):
        return cloud, size_warnings(detected, cloud.source_scale) if detected > 0 else ()
    scale = scale_to(height_m or DEFAULT_HEIGHT_M, detected)
    assert scale is not None
    scaled = replace(transformed(cloud, np.eye(3), scale), source_scale=cloud.source_scale * scale)
    if height_m is not None:
        return scaled, ()
    message = (
        f"a splat's file does not say how large it is; {detected:.3g} units were taken for {DEFAULT_HEIGHT_M:g} m; "
        "set height_m to its height, or unit_m to the metres in one unit of the file"
    )
    return scaled, (SourceWarning(code="size-unknown", message=message),)


def cloud_height(cloud: GaussianCloud) -> float:
    """Extent along +Z without strays [m]."""
    low, high = np.quantile(cloud.means[:, 2], [_STRAYS, 1 - _STRAYS])
    return float(high - low)
