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
    from dynamictree.devoxelize.interpolation import VoxelInterpolation  # brings numba, which only vertices need
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
    interpolation: "VoxelInterpolation | None" = None
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


def vertex_ties(ready: ReadyTree, mesh: TriangleMesh) -> "VoxelInterpolation":
    """Interpolation from the voxels to the mesh's vertices."""
    from dynamictree.devoxelize.smooth import smooth

    if ready.interpolation is None:
        ready.interpolation = smooth(ready.tree.system.grid, mesh)
    return ready.interpolation


def vertex_frames(ready: ReadyTree, mesh: TriangleMesh) -> "VertexFrames":
    """Basis that gives the mesh's vertices at any modal coordinates."""
    from dynamictree.modal.frames import VertexFrames

    if ready.frames is None:
        ready.frames = VertexFrames(ready.tree.system, vertex_ties(ready, mesh))
    return ready.frames


def bone_ties(ready: ReadyTree, mesh: TriangleMesh) -> BoneAttachment:
    """Weights that attach the mesh's vertices to the bones."""
    if ready.attachment is None:
        ties = vertex_ties(ready, mesh)
        grid = ready.tree.system.grid
        ready.attachment = attach_mesh(ready.tree.bones, mesh, ties, voxel_size_m=grid.voxel_size_m)
    return ready.attachment
