"""A splat or scan as someone sends it: the cloud, which of it may move, and a mesh if one came with it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud, in_box
from dynamictree.mesh import SourceWarning, TriangleMesh
from dynamictree.requests import Box


@dataclass(frozen=True, kw_only=True)
class Capture:
    """A cloud and what came with it."""

    cloud: GaussianCloud
    mask: Bool[np.ndarray, " G"] | None = None  # which Gaussians may move; all if there is none
    mesh: TriangleMesh | None = None  # what they hang on, where the cloud is; made from the cloud if there is none
    warnings: tuple[SourceWarning, ...] = ()

    def __post_init__(self) -> None:
        if self.mask is not None and len(self.mask) != self.cloud.num_gaussians:
            raise InputError(
                f"the mask has {len(self.mask):,} values for {self.cloud.num_gaussians:,} Gaussians; "
                "it needs one a Gaussian, in the file's order"
            )
        if self.mask is not None and not self.mask.any():
            raise InputError("the mask lets no Gaussian move; set it to 1 where the tree is")


def moving_part(capture: Capture, box_m: Box | None = None) -> Bool[np.ndarray, " G"]:
    """Which Gaussians may move: those of the mask and in the box.

    Raises:
        InputError: there are none.
    """
    mask = np.ones(capture.cloud.num_gaussians, np.bool_) if capture.mask is None else capture.mask
    if box_m is None:
        return mask
    both: Bool[np.ndarray, " G"] = mask & in_box(capture.cloud, *box_m)
    if not both.any():
        raise InputError(f"no Gaussian of the mask is in the box from {box_m[0]} to {box_m[1]}; enlarge one of them")
    return both


def carrying_mesh(capture: Capture, box_m: Box | None = None) -> TriangleMesh:
    """The mesh that was sent, or one of the part that moves: what is voxelised, and what the Gaussians hang on.

    Raises:
        InputError: nothing is in the box, or nothing is opaque enough to have a surface.
    """
    from dynamictree.gaussian.surface import mesh_of_cloud

    moving = moving_part(capture, box_m)
    return capture.mesh or mesh_of_cloud(capture.cloud.subset(moving))
