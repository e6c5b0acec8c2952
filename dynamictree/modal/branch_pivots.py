"""Where each vertex' branch begins: what a foliage shader turns it about."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float32, Int64

from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.branch_groups import branch_orders, branches_of
from dynamictree.modal.branch_skin import branch_skin
from dynamictree.spectrum import SparseVoxelSpectrum


@dataclass(frozen=True, kw_only=True)
class BranchPivots:
    """The foot of each vertex' branch, and the branch's order: 0 is the trunk. Then the E branches as a hierarchy."""

    pivot_m: Float32[np.ndarray, "N 3"]  # of the joint that carries most of the vertex
    order: Int64[np.ndarray, " N"]
    branch: Int64[np.ndarray, " N"]
    foot_m: Float32[np.ndarray, "E 3"]
    parent: Int64[np.ndarray, " E"]  # its own number at a root


def branch_pivots(
    spectrum: SparseVoxelSpectrum, mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"]
) -> BranchPivots:
    """Pivot and order of the joint that carries most of each vertex; the tree's foot where it has no branches."""
    try:
        skin, _ = branch_skin(spectrum, mesh, coefficients)
    except InputError:  # it moves as one piece
        low = mesh.vertices[mesh.vertices[:, 2].argmin()]
        pivot: Float32[np.ndarray, "N 3"] = np.tile(low, (mesh.num_vertices, 1))
        none = np.zeros(mesh.num_vertices, np.int64)
        return BranchPivots(pivot_m=pivot, order=none, branch=none, foot_m=pivot[:1], parent=none[:1])
    strongest = skin.rows[np.arange(mesh.num_vertices), skin.weights.argmax(axis=1)]
    branch, first = branches_of(skin.parent)
    above = skin.parent[first]
    return BranchPivots(
        pivot_m=skin.joint_m[strongest],
        order=branch_orders(skin.parent)[strongest],
        branch=branch[strongest],
        foot_m=skin.joint_m[first],
        parent=np.where(above < 0, np.arange(len(first)), branch[np.maximum(above, 0)]),
    )
