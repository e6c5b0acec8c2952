"""A splat or scan as uploaded: the cloud, an optional mask of what may move, and an optional mesh."""

from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Bool, Int32, UInt8

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import SourceWarning, StillPart, TriangleMesh
from dynamictree.plant.choice import choose_gaussians
from dynamictree.plant.likeness import VISIBLE
from dynamictree.plant.still_cloud import find_still_gaussians
from dynamictree.plant.trees.segment import require_tree
from dynamictree.requests import CloudParams


@dataclass(frozen=True, kw_only=True)
class Capture:
    """A cloud and what came with it."""

    cloud: GaussianCloud
    mask: Bool[np.ndarray, " G"] | None = None  # which Gaussians may move; all if there is none
    mesh: TriangleMesh | None = None  # what they hang on, where the cloud is; made from the cloud if there is none
    tree: Int32[np.ndarray, " G"] | None = None  # of several trees the one, from 0; -1 for ground; None for one tree
    warnings: tuple[SourceWarning, ...] = ()
    still_parts: tuple[StillPart, ...] = ()  # what was found to be no plant
    part_of: UInt8[np.ndarray, " G"] | None = None  # number of the part from 1, or 0; None if there are none

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
    """The capture with what is not the plant found in it, unless a mask says what may move."""
    if capture.mask is not None:
        return capture
    parts, part_of = find_still_gaussians(capture.cloud)
    return replace(capture, still_parts=parts, part_of=part_of) if parts else capture


def moving_part(capture: Capture, choice: CloudParams | None = None) -> Bool[np.ndarray, " G"]:
    """Which Gaussians may move: those of the mask, or of the plant if there is none, and what the request says.

    Raises:
        InputError: there are none, or a name or box that fits nothing.
    """
    mask = np.ones(capture.cloud.num_gaussians, np.bool_) if capture.mask is None else capture.mask
    if capture.part_of is not None:
        mask = mask & (capture.part_of == 0)
    if capture.tree is not None:
        mask = mask & (capture.tree >= 0)  # the ground stands still
    if choice is None:
        return mask
    names = [part.name for part in capture.still_parts]
    return choose_gaussians(capture.cloud.means, mask, names, capture.part_of, choice)


def carrying_mesh(capture: Capture, choice: CloudParams | None = None) -> TriangleMesh:
    """The mesh that was sent, or one of the part that moves: what is voxelised, and what the Gaussians hang on.

    Of a mesh that was sent, faces stand still where detected parts of the cloud do.

    Raises:
        InputError: nothing is in the box, or nothing is opaque enough to have a surface.
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
    """One of several trees by itself, counted from 1; without the ground.

    Raises:
        InputError: there is no such tree.
    """
    require_tree(number, capture.tree)
    if capture.tree is None:
        return capture
    own = (capture.tree == number - 1) & moving_part(capture)
    nothing = None if capture.part_of is None else np.zeros(int(own.sum()), np.uint8)  # names of parts stay valid
    return replace(capture, cloud=capture.cloud.subset(own), mask=None, tree=None, part_of=nothing)


def move_only_tree(capture: Capture, number: int) -> Capture:
    """The whole cloud, of which only one of several trees may move; counted from 1.

    Raises:
        InputError: there is no such tree, or the mask lets none of it move.
    """
    require_tree(number, capture.tree)
    if capture.tree is None:
        return capture
    return replace(capture, mask=moving_part(capture) & (capture.tree == number - 1), tree=None)
