"""A tree prepared for interaction: modal system, and on demand its mesh, attachments and Gaussians."""

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int32

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.interactive_tree import InteractiveTree

if TYPE_CHECKING:
    from dynamictree.gaussian.deform import Deformer  # imports numba

BYTES_PER_VOXEL = 1500  # modal system; measured at K = 16
BYTES_PER_VERTEX = 250  # mesh and rig
BYTES_PER_GAUSSIAN = 250  # rest pose, and the deformer's arrays


@dataclass(frozen=True)
class BoundGaussians:
    """Gaussians bound to the mesh. The deformer computes one pose at a time."""

    rows: Int32[np.ndarray, " M"]  # indices into the cloud
    deformer: "Deformer"
    alone: threading.Lock = field(default_factory=threading.Lock)


@dataclass
class ReadyTree:
    """A tree prepared for interaction; its source mesh is loaded on demand."""

    tree: InteractiveTree
    expires_at: float  # expiry time of the spectrum [s since 1970]
    mesh: TriangleMesh | None = None
    gaussians: BoundGaussians | None = None

    @property
    def num_bytes(self) -> int:
        """Return the approximate size [bytes]."""
        vertices = 0 if self.mesh is None else self.mesh.num_vertices
        gaussians = 0 if self.gaussians is None else len(self.gaussians.rows)
        extra_bytes = BYTES_PER_VERTEX * vertices + BYTES_PER_GAUSSIAN * gaussians
        bone_bytes = 0 if self.tree.rig is None else 3 * self.tree.rig.turns.nbytes
        return BYTES_PER_VOXEL * len(self.tree.system.grid) + extra_bytes + bone_bytes
