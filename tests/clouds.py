"""Small clouds of Gaussians."""

import numpy as np

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.rotation import unit_quaternions


def cloud_at(
    means: np.ndarray, *, turned: object = (1, 0, 0, 0), scale: object = 0.02, opacity: object = 0.9, sh: object = None
) -> GaussianCloud:
    """Gaussians at these places; any other value may be the same for all."""

    def rows(values: object, *width: int) -> np.ndarray:
        return np.array(np.broadcast_to(np.asarray(values, np.float32), (len(means), *width)), order="C")

    return GaussianCloud(
        means=np.asarray(means, np.float32),
        quaternions=unit_quaternions(rows(turned, 4)),
        scales=rows(scale, 3),
        opacity=rows(opacity),
        sh=rows(0, 1, 3) if sh is None else np.asarray(sh, np.float32),
    )
