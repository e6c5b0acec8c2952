"""Trees made ready to be pushed, kept in memory up to a bound."""

import threading
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int32

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.response import InteractiveTree
from dynamictree.modal.surface import BoneAttachment, attach_mesh
from dynamictree.modal.system import modal_system
from jobs.assets import read_asset
from service.context import Context
from service.stored_trees import load_source_cloud, load_source_mesh, load_spectrum, spectrum_artifact

if TYPE_CHECKING:
    from dynamictree.gaussian.deform import Deformer  # brings numba
    from dynamictree.voxel.devoxelize import VoxelInterpolation  # brings numba, which only vertices need

BYTES_A_VOXEL = 1500  # modes, and the graph that displacements need; measured at K = 16
BYTES_A_VERTEX = 250  # the mesh, and what ties it to voxels and bones
BYTES_A_GAUSSIAN = 250  # at rest, and laid out for the deformer


@dataclass(frozen=True)
class MovingGaussians:
    """Those of a cloud that hang on the mesh. The deformer is one pose's at a time."""

    rows: Int32[np.ndarray, " M"]  # in the cloud
    deformer: "Deformer"
    alone: threading.Lock = field(default_factory=threading.Lock)


@dataclass
class ReadyTree:
    """A tree, and its source mesh once something on it was asked for."""

    tree: InteractiveTree
    expires_at: float  # of the spectrum
    mesh: TriangleMesh | None = None
    interpolation: "VoxelInterpolation | None" = None
    attachment: BoneAttachment | None = None
    gaussians: MovingGaussians | None = None

    @property
    def num_bytes(self) -> int:
        """About what it takes [bytes]."""
        vertices = 0 if self.mesh is None else self.mesh.num_vertices
        gaussians = 0 if self.gaussians is None else len(self.gaussians.rows)
        known = BYTES_A_VERTEX * vertices + BYTES_A_GAUSSIAN * gaussians
        return BYTES_A_VOXEL * len(self.tree.system.grid) + known


def ready_tree(context: Context, spectrum_id: str) -> ReadyTree:
    """The tree of a spectrum.

    Raises:
        NotFoundError, GoneError: there is none, or it has expired.
    """
    kept = living_tree(context, spectrum_id)
    if kept is None:
        artifact = spectrum_artifact(context, spectrum_id)
        tree = InteractiveTree(modal_system(load_spectrum(context, spectrum_id)))
        kept = ReadyTree(tree, artifact.expires_at)
        context.trees.put(_key(context, spectrum_id), kept)
    return kept


def living_tree(context: Context, spectrum_id: str) -> ReadyTree | None:
    """The tree of a spectrum if it is kept in memory and has not expired; asks no store."""
    kept = context.trees.get(_key(context, spectrum_id))
    return kept if kept is not None and context.store.clock() < kept.expires_at else None


def _key(context: Context, spectrum_id: str) -> str:
    """An owner finds only what they were allowed to load."""
    return f"{context.caller.owner or ''}/{spectrum_id}"


def with_mesh(context: Context, ready: ReadyTree, spectrum_id: str) -> TriangleMesh:
    """The tree's source mesh.

    Raises:
        GoneError: the asset has expired.
    """
    artifact = spectrum_artifact(context, spectrum_id)
    read_asset(context.store, context.store.job(artifact.job_id).asset_id)  # tells when it has expired
    if ready.mesh is None:
        ready.mesh = load_source_mesh(context, spectrum_id)
    return ready.mesh


def vertex_ties(ready: ReadyTree, mesh: TriangleMesh) -> "VoxelInterpolation":
    """What ties the mesh's vertices to the voxels."""
    from dynamictree.voxel.devoxelize import smooth

    if ready.interpolation is None:
        ready.interpolation = smooth(ready.tree.system.grid, mesh)
    return ready.interpolation


def moving_gaussians(context: Context, ready: ReadyTree, spectrum_id: str) -> MovingGaussians:
    """What of the source cloud moves, hung on the mesh that was made of it.

    Raises:
        GoneError: the asset has expired.
        ProblemError: the source is no cloud.
    """
    from dynamictree.gaussian.binding import bind_capture
    from dynamictree.gaussian.deform import Deformer

    mesh = with_mesh(context, ready, spectrum_id)
    if ready.gaussians is None:
        capture, box = load_source_cloud(context, spectrum_id)
        binding = bind_capture(capture, mesh, box)
        rows = np.flatnonzero(binding.moving).astype(np.int32)
        moving = replace(
            binding,
            cloud=binding.cloud.subset(rows).with_sh_degree(0),
            face_of=binding.face_of[rows],
            weights=binding.weights[rows],
        )
        ready.gaussians = MovingGaussians(rows, Deformer(moving))
    return ready.gaussians


def bone_ties(ready: ReadyTree, mesh: TriangleMesh) -> BoneAttachment:
    """What ties the mesh's vertices to the bones."""
    if ready.attachment is None:
        ties = vertex_ties(ready, mesh)
        grid = ready.tree.system.grid
        ready.attachment = attach_mesh(
            ready.tree.bones, mesh, rows=ties.rows, weights=ties.weights, voxel_size_m=grid.voxel_size_m
        )
    return ready.attachment
