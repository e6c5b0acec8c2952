"""Uploaded splat or scan: the cloud, an optional mask of Gaussians that may move, and an optional mesh."""

from dataclasses import dataclass, replace

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Bool, Int32, UInt8

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import SourceWarning, StillPart, TriangleMesh
from dynamictree.plant.choice import choose_gaussians
from dynamictree.plant.plausibility import VISIBLE
from dynamictree.plant.still_cloud import find_still_gaussians
from dynamictree.plant.trees.segment import require_tree
from dynamictree.requests import CloudParams


@dataclass(frozen=True, kw_only=True)
class Capture:
    """Cloud with its optional mask, mesh, trees and still parts."""

    cloud: GaussianCloud
    mask: Bool[np.ndarray, " G"] | None = None  # mask of Gaussians that may move; None for all
    mesh: TriangleMesh | None = None  # mesh to bind to, in the cloud's frame; None to extract it from the cloud
    tree: Int32[np.ndarray, " G"] | None = None  # number of the tree, from 0; -1 for ground; None for one tree
    warnings: tuple[SourceWarning, ...] = ()
    still_parts: tuple[StillPart, ...] = ()  # detected parts that are no plant
    part_of: UInt8[np.ndarray, " G"] | None = None  # number of the still part from 1, or 0; None if there are none

    def __post_init__(self) -> None:
        if self.mask is not None and len(self.mask) != self.cloud.num_gaussians:
            raise InputError(
                f"the mask has {len(self.mask):,} values for {self.cloud.num_gaussians:,} Gaussians; "
                "it needs one a Gaussian, in the file's order"
            )
        if self.mask is not None and not self.mask.any():
            raise InputError("the mask lets no Gaussian move; set it to 1 where the tree is")
        if self.tree is not None and len(self.tree) != self.cloud.num_gaussians:
            raise InputError(f"{len(self.tree):,} numbers of trees for {self.cloud.num_gaussians:,} Gaussians")


def with_still_parts(capture: Capture) -> Capture:
    """Detect the capture's still parts, unless a mask says what may move."""
    if capture.mask is not None:
        return capture
    parts, part_of = find_still_gaussians(capture.cloud)
    return replace(capture, still_parts=parts, part_of=part_of) if parts else capture


def moving_part(capture: Capture, choice: CloudParams | None = None) -> Bool[np.ndarray, " G"]:
    """Return a mask of the Gaussians that may move, from the capture's mask, its still parts and the request.

    Raises:
        InputError: no Gaussian may move, or a name or box of the request matches nothing.
    """
    mask = np.ones(capture.cloud.num_gaussians, np.bool_) if capture.mask is None else capture.mask
    if capture.part_of is not None:
        mask = mask & (capture.part_of == 0)
    if capture.tree is not None:
        mask = mask & (capture.tree >= 0)  # excludes the ground
    if choice is None:
        return mask
    names = [part.name for part in capture.still_parts]
    return choose_gaussians(capture.cloud.means, mask, names, capture.part_of, choice)


def carrying_mesh(capture: Capture, choice: CloudParams | None = None) -> TriangleMesh:
    """Return the mesh to voxelize and to bind Gaussians to: the given one, or one of the moving Gaussians.

    Faces of a given mesh are still where the nearest Gaussian belongs to a still part.

    Raises:
        InputError: the box is empty, or no Gaussian in it is opaque enough for a surface.
    """
    from dynamictree.gaussian.cloud_mesh import mesh_of_trees

    moving = moving_part(capture, choice)
    if capture.mesh is None:
        return mesh_of_trees(capture.cloud.subset(moving), None if capture.tree is None else capture.tree[moving])
    if capture.part_of is None:
        return capture.mesh
    return _still_where_gaussians_are(capture.mesh, capture.cloud, (capture.part_of > 0) & ~moving)


def _still_where_gaussians_are(mesh: TriangleMesh, cloud: GaussianCloud, still: Bool[np.ndarray, " G"]) -> TriangleMesh:
    visible = np.flatnonzero(cloud.opacity >= VISIBLE)
    if len(visible) == 0:
        return mesh
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    faces = still[visible][scipy.spatial.cKDTree(cloud.means[visible]).query(middles)[1]]
    if mesh.still_faces is not None:
        faces |= mesh.still_faces
    return mesh if faces.all() else replace(mesh, still_faces=faces)


def only_tree(capture: Capture, number: int) -> Capture:
    """Extract one of several trees, counted from 1, without the ground.

    Raises:
        InputError: there is no such tree.
    """
    require_tree(number, capture.tree)
    if capture.tree is None:
        return capture
    own = (capture.tree == number - 1) & moving_part(capture)
    nothing = None if capture.part_of is None else np.zeros(int(own.sum()), np.uint8)  # the names of parts remain valid
    return replace(capture, cloud=capture.cloud.subset(own), mask=None, tree=None, part_of=nothing)


def with_one_moving_tree(capture: Capture, number: int) -> Capture:
    """Return the whole cloud with only one of several trees, counted from 1, allowed to move.

    Raises:
        InputError: there is no such tree, or the mask excludes all of it.
    """
    require_tree(number, capture.tree)
    if capture.tree is None:
        return capture
    return replace(capture, mask=moving_part(capture) & (capture.tree == number - 1), tree=None)
