"""A tree prepared for interaction: modal system, and on demand its mesh, attachments and Gaussians."""

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int32

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.bone_attachment import BoneAttachment, attach_mesh
from dynamictree.modal.interactive_tree import InteractiveTree

if TYPE_CHECKING:
    from dynamictree.devoxelize.shares import VoxelShares  # brings numba, which only vertices need
    from dynamictree.gaussian.deform import Deformer  # brings numba
    from dynamictree.modal.frames import VertexFrames  # likewise
    from dynamictree.rig.rig import Rig  # likewise

BYTES_A_VOXEL = 1500  # modes, and the graph that displacements need; measured at K = 16
BYTES_A_VERTEX = 250  # the mesh, and what ties it to voxels and bones
BYTES_A_GAUSSIAN = 250  # at rest, and laid out for the deformer


@dataclass(frozen=True)
class MovingGaussians:
    """Gaussians bound to the mesh. The deformer computes one pose at a time."""

    rows: Int32[np.ndarray, " M"]  # in the cloud
    deformer: "Deformer"
    alone: threading.Lock = field(default_factory=threading.Lock)


@dataclass
class ReadyTree:
    """A tree prepared for interaction; its source mesh is loaded on demand."""

    tree: InteractiveTree
    expires_at: float  # of the spectrum
    mesh: TriangleMesh | None = None
    shares: "VoxelShares | None" = None
    frames: "VertexFrames | None" = None
    attachment: BoneAttachment | None = None
    gaussians: MovingGaussians | None = None
    rig: "Rig | None" = None

    @property
    def num_bytes(self) -> int:
        """Approximate size [bytes]."""
        vertices = 0 if self.mesh is None else self.mesh.num_vertices
        gaussians = 0 if self.gaussians is None else len(self.gaussians.rows)
        extra_bytes = BYTES_A_VERTEX * vertices + BYTES_A_GAUSSIAN * gaussians
        basis_bytes = 0 if self.frames is None else self.frames.num_bytes
        bone_bytes = 0 if self.rig is None else self.rig.turns.nbytes
        return BYTES_A_VOXEL * len(self.tree.system.grid) + extra_bytes + basis_bytes + bone_bytes


def vertex_shares(ready: ReadyTree, mesh: TriangleMesh) -> "VoxelShares":
    """The voxels that the mesh's vertices depend on."""
    from dynamictree.devoxelize.shares import voxel_shares

    if ready.shares is None:
        ready.shares = voxel_shares(ready.tree.system.grid, mesh)
    return ready.shares


def bone_ties(ready: ReadyTree, mesh: TriangleMesh) -> BoneAttachment:
    """Weights that attach the mesh's vertices to the bones."""
    if ready.attachment is None:
        shares, voxel_m = vertex_shares(ready, mesh), ready.tree.system.grid.voxel_size_m
        ready.attachment = attach_mesh(ready.tree.bones, mesh, shares, voxel_size_m=voxel_m)
    return ready.attachment
