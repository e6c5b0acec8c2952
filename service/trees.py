"""Trees made ready to be pushed, kept in memory up to a bound."""

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.response import InteractiveTree
from dynamictree.modal.surface import BoneAttachment, attach_mesh
from dynamictree.modal.system import modal_system
from service.context import Context
from service.spectra import load_source_mesh, load_spectrum, spectrum_artifact

if TYPE_CHECKING:
    from dynamictree.voxel.devoxelize import VoxelInterpolation  # brings numba, which only vertices need

BYTES_A_VOXEL = 1500  # modes, and the graph that displacements need; measured at K = 16
BYTES_A_VERTEX = 250  # the mesh, and what ties it to voxels and bones


@dataclass
class ReadyTree:
    """A tree, and its source mesh once something on it was asked for."""

    tree: InteractiveTree
    expires_at: float  # of the spectrum
    mesh: TriangleMesh | None = None
    interpolation: "VoxelInterpolation | None" = None
    attachment: BoneAttachment | None = None

    @property
    def num_bytes(self) -> int:
        """About what it takes [bytes]."""
        vertices = 0 if self.mesh is None else self.mesh.num_vertices
        return BYTES_A_VOXEL * len(self.tree.system.grid) + BYTES_A_VERTEX * vertices


@dataclass
class ReadyTrees:
    """The trees that were pushed last, by the id of their spectrum."""

    max_bytes: int
    _kept: "OrderedDict[str, ReadyTree]" = field(default_factory=OrderedDict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def get(self, key: str) -> ReadyTree | None:
        """The tree, if it is kept."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def put(self, key: str, ready: ReadyTree) -> None:
        """Keep a tree; drop those that were not pushed for longest."""
        with self._lock:
            self._kept[key] = ready
            while len(self._kept) > 1 and sum(tree.num_bytes for tree in self._kept.values()) > self.max_bytes:
                self._kept.popitem(last=False)

    def __len__(self) -> int:
        return len(self._kept)


def ready_tree(context: Context, trees: ReadyTrees, spectrum_id: str) -> ReadyTree:
    """The tree of a spectrum.

    Raises:
        NotFoundError, GoneError: there is none, or it has expired.
    """
    kept = living_tree(context, trees, spectrum_id)
    if kept is None:
        artifact = spectrum_artifact(context, spectrum_id)
        tree = InteractiveTree(modal_system(load_spectrum(context, spectrum_id)))
        kept = ReadyTree(tree, artifact.expires_at)
        trees.put(_key(context, spectrum_id), kept)
    return kept


def living_tree(context: Context, trees: ReadyTrees, spectrum_id: str) -> ReadyTree | None:
    """The tree of a spectrum if it is kept in memory and has not expired; asks no store."""
    kept = trees.get(_key(context, spectrum_id))
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
    context.store.asset(context.store.job(artifact.job_id).asset_id)  # tells when it has expired
    if ready.mesh is None:
        ready.mesh = load_source_mesh(context, spectrum_id)
    return ready.mesh


def vertex_ties(ready: ReadyTree, mesh: TriangleMesh) -> "VoxelInterpolation":
    """What ties the mesh's vertices to the voxels."""
    from dynamictree.voxel.devoxelize import smooth

    if ready.interpolation is None:
        ready.interpolation = smooth(ready.tree.system.grid, mesh)
    return ready.interpolation


def bone_ties(ready: ReadyTree, mesh: TriangleMesh) -> BoneAttachment:
    """What ties the mesh's vertices to the bones."""
    if ready.attachment is None:
        ties = vertex_ties(ready, mesh)
        grid = ready.tree.system.grid
        ready.attachment = attach_mesh(
            ready.tree.bones, mesh, rows=ties.rows, weights=ties.weights, voxel_size_m=grid.voxel_size_m
        )
    return ready.attachment
