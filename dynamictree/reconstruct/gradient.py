"""Backward pass of the rasterizer `gaussian.rasterize.draw`.

The gradient is that of Kerbl et al. 2023, appendix A, extended by Mip-Splatting's opacity and depth; numba, on the CPU.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from dynamictree.gaussian.rasterize import Drawing
from dynamictree.parallel import in_bands
from dynamictree.reconstruct.backward_kernel import ENTRY, blend_back, gather, project_back


class Gradients(NamedTuple):
    """Gradients of a loss by the Gaussians' parameters; zero for Gaussians that the camera does not see."""

    table: Float32[np.ndarray, "G P"]  # columns: mean, quaternion, ln scales, logit opacity, harmonics by channel
    centres_px: Float32[np.ndarray, "G 2"]  # gradient by the position in the picture, for densification


def gradients_of(drawing: Drawing, gradient: Float32[np.ndarray, "H W 5"], *, width: int = 0) -> Gradients:
    """Compute the gradients of a loss by the Gaussians, from its gradient by the drawing's picture.

    A positive `width` pads the table with zeros for harmonics that were not drawn.
    """
    entries = np.zeros((len(drawing.order), ENTRY), np.float32)
    ellipses, bounds = drawing.ellipses, drawing.bounds
    lists = (drawing.order, drawing.starts)
    in_bands(blend_back, len(drawing.starts) - 1, ellipses, bounds, *lists, drawing.picture, gradient, entries)
    cloud = drawing.cloud
    assert cloud.sh_degree <= 2, "gradients of harmonics are there up to degree 2"
    of_ellipses = np.zeros((cloud.num_gaussians, ENTRY), np.float32)
    gather(drawing.order, entries, of_ellipses)
    table = np.zeros((cloud.num_gaussians, max(width, 11 + cloud.sh[0].size)), np.float32)
    shapes = cloud.means, cloud.quaternions, cloud.scales, cloud.opacity, cloud.sh
    in_bands(project_back, cloud.num_gaussians, *shapes, drawing.view, bounds, ellipses, of_ellipses, table)
    return Gradients(table=table, centres_px=of_ellipses[:, :2])
