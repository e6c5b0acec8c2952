"""Differentiable rendering of Gaussians: the forward pass of `gaussian.rasterize`, and its gradient.

The gradient of Kerbl et al. 2023, appendix A, with that of Mip-Splatting's opacity and of the depth; numba, on the CPU.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, Int64

from dynamictree.gaussian.rasterize import tile_lists
from dynamictree.gaussian.rasterize_kernel import WIDEST, blend, project
from dynamictree.parallel import in_bands
from dynamictree.reconstruct.backward_kernel import ENTRY, blend_back, gather, project_back
from dynamictree.render.camera import Camera


@dataclass(frozen=True, kw_only=True)
class Shapes:
    """Gaussians as the renderer takes them: `GaussianCloud`'s fields, of which quaternions are unit ones."""

    means: Float32[np.ndarray, "G 3"]
    quaternions: Float32[np.ndarray, "G 4"]
    scales: Float32[np.ndarray, "G 3"]
    opacity: Float32[np.ndarray, " G"]
    sh: Float32[np.ndarray, "G H 3"]

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """Every field, in the order in which the kernels take them."""
        return self.means, self.quaternions, self.scales, self.opacity, self.sh


@dataclass(frozen=True, kw_only=True)
class Gradients:
    """Of a loss, by what is optimised. Zero for what the camera does not see."""

    table: Float32[np.ndarray, "G P"]  # mean, quaternion, ln scales, logit of the opacity, harmonics by channel
    centres_px: Float32[np.ndarray, "G 2"]  # by the place in the picture, which decides on densification


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """A rendered picture, and what its backward pass needs."""

    shapes: Shapes
    view: Float32[np.ndarray, "19"]
    antialias: bool
    ellipses: Float32[np.ndarray, "G 10"]
    bounds: Int32[np.ndarray, "G 4"]  # left, right, top, bottom [px]; empty where not seen
    order: Int32[np.ndarray, " listed"]
    starts: Int64[np.ndarray, " tiles_and_one"]
    picture: Float32[np.ndarray, "H W 5"]  # colour and depth, both times alpha, and what is left of the light


def draw(shapes: Shapes, camera: Camera, *, width: int, height: int, antialias: bool = True) -> Drawing:
    """The forward pass; the same picture as `render_cloud`'s."""
    number = len(shapes.means)
    ellipses, bounds = np.zeros((number, 10), np.float32), np.zeros((number, 4), np.int32)
    view = _view(camera, width, height)
    in_bands(
        project,
        number,
        *shapes.arrays,
        shapes.quaternions,
        view,
        antialias,
        False,
        ellipses,
        bounds,
    )
    order, starts = tile_lists(ellipses, bounds, width, height)
    picture = np.zeros((height, width, 5), np.float32)
    in_bands(blend, len(starts) - 1, ellipses, bounds, order, starts, picture)
    return Drawing(
        shapes=shapes,
        view=view,
        antialias=antialias,
        ellipses=ellipses,
        bounds=bounds,
        order=order,
        starts=starts,
        picture=picture,
    )


def gradients_of(drawing: Drawing, gradient: Float32[np.ndarray, "H W 5"], *, width: int = 0) -> Gradients:
    """The backward pass, from the gradient of a loss by the drawing's picture.

    A table of that width has zeros for harmonics that were not drawn.
    """
    entries = np.zeros((len(drawing.order), ENTRY), np.float32)
    ellipses, bounds = drawing.ellipses, drawing.bounds
    lists = (drawing.order, drawing.starts)
    in_bands(blend_back, len(drawing.starts) - 1, ellipses, bounds, *lists, drawing.picture, gradient, entries)
    shapes = drawing.shapes
    number = len(shapes.means)
    of_ellipses = np.zeros((number, ENTRY), np.float32)
    gather(drawing.order, entries, of_ellipses)
    table = np.zeros((number, max(width, 11 + shapes.sh[0].size)), np.float32)
    in_bands(
        project_back,
        number,
        *shapes.arrays,
        drawing.view,
        drawing.antialias,
        bounds,
        ellipses,
        of_ellipses,
        table,
    )
    return Gradients(table=table, centres_px=of_ellipses[:, :2])


def _view(camera: Camera, width: int, height: int) -> Float32[np.ndarray, "19"]:
    """Camera as the kernels take it: rotation by rows, position, focal length, centre, size, and widest slopes."""
    intrinsics = camera.intrinsics_px(width, height)
    numbers = [
        *camera.world_to_camera.ravel(),
        *camera.position_m,
        *(intrinsics[0, 0], intrinsics[0, 2], intrinsics[1, 2], width, height),
        *(WIDEST * 0.5 * np.array([width, height]) / intrinsics[0, 0]),
    ]
    return np.array(numbers, np.float32)
