"""Load trees for interaction, from memory where they were used recently."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.force import Contact, contact_at_point
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.system import modal_system
from jobs.storage.assets import read_asset
from service.http.problems import ProblemError
from service.interact.ready_tree import MovingGaussians, ReadyTree
from service.interact.stored_trees import (
    load_result,
    load_source_cloud,
    load_source_mesh,
    load_spectrum,
    spectrum_artifact,
)
from service.services import Owned

if TYPE_CHECKING:
    from dynamictree.modal.frames import VertexFrames
    from dynamictree.rig.rig import Rig


def ready_tree(owned: Owned, spectrum_id: str) -> ReadyTree:
    """The tree of a spectrum.

    Raises:
        NotFoundError, GoneError: there is none, or it has expired.
    """
    tree_ready = living_tree(owned, spectrum_id)
    if tree_ready is None:
        artifact = spectrum_artifact(owned, spectrum_id)
        tree = InteractiveTree(modal_system(load_spectrum(owned, spectrum_id)))
        tree_ready = ReadyTree(tree, artifact.expires_at)
        owned.services.trees.put(_key(owned, spectrum_id), tree_ready)
    return tree_ready


def living_tree(owned: Owned, spectrum_id: str) -> ReadyTree | None:
    """The cached tree of a spectrum, if it has not expired; without a query."""
    tree_ready = owned.services.trees.get(_key(owned, spectrum_id))
    return tree_ready if tree_ready is not None and owned.store.clock() < tree_ready.expires_at else None


def _key(owned: Owned, spectrum_id: str) -> str:
    """Cache key, which includes the owner."""
    return f"{owned.caller.owner or ''}/{spectrum_id}"


def with_mesh(owned: Owned, ready: ReadyTree, spectrum_id: str) -> TriangleMesh:
    """The tree's source mesh.

    Raises:
        GoneError: the asset has expired.
    """
    artifact = spectrum_artifact(owned, spectrum_id)
    read_asset(owned.store, owned.store.job(artifact.job_id).asset_id)  # tells when it has expired
    if ready.mesh is None:
        ready.mesh = load_source_mesh(owned, spectrum_id)
    return ready.mesh


def vertex_contact(
    owned: Owned, ready: ReadyTree, spectrum_id: str, vertex: int, radius_m: float, *, bent: bool
) -> Contact:
    """Where a force at a vertex acts; in the bent shape a drag by displacement holds the vertex itself.

    Raises:
        GoneError: the asset has expired.
        InputError, ProblemError: there is no such vertex, or no voxel near it.
    """
    mesh = with_mesh(owned, ready, spectrum_id)
    if vertex >= mesh.num_vertices:
        detail = f"vertex {vertex} does not exist; the mesh has vertices 0 to {mesh.num_vertices - 1}"
        raise ProblemError("invalid-input", detail)
    if bent:
        return with_rig(owned, ready, spectrum_id).contact_at_vertex(mesh.vertices, vertex, radius_m=radius_m)
    x, y, z = mesh.vertices[vertex].tolist()
    return contact_at_point(ready.tree.system.grid, (x, y, z), radius_m=radius_m)


def rig_for(owned: Owned, ready: ReadyTree, spectrum_id: str) -> "Rig":
    """The tree's rig: that of the products, or found where no job has needed it yet."""
    from dynamictree.formats.tensors.rig import read_rig  # brings numba
    from dynamictree.rig.rig import rig_of

    if ready.tree.rig is None:
        mesh = with_mesh(owned, ready, spectrum_id)
        stream = load_result(owned, spectrum_id, "rig")
        rig = rig_of(mesh, load_spectrum(owned, spectrum_id)) if stream is None else read_rig(stream)
        ready.tree = InteractiveTree(ready.tree.system, rig, mesh.faces)
        return rig
    return ready.tree.rig


def with_rig(owned: Owned, ready: ReadyTree, spectrum_id: str) -> InteractiveTree:
    """The tree with its rig, which locality and bends need."""
    rig_for(owned, ready, spectrum_id)
    return ready.tree


def vertex_frames(owned: Owned, ready: ReadyTree, spectrum_id: str) -> "VertexFrames":
    """Basis that gives the mesh's vertices at any modal coordinates."""
    from dynamictree.modal.frames import VertexFrames  # brings numba

    if ready.frames is None:
        mesh, rig = with_mesh(owned, ready, spectrum_id), rig_for(owned, ready, spectrum_id)
        ready.frames = VertexFrames(rig, mesh.vertices)
    return ready.frames


def moving_gaussians(owned: Owned, ready: ReadyTree, spectrum_id: str) -> MovingGaussians:
    """Moving Gaussians of the source cloud, bound to its mesh.

    Raises:
        GoneError: the asset has expired.
        ProblemError: the source is no cloud.
    """
    from dynamictree.gaussian.binding import bind
    from dynamictree.gaussian.deform import Deformer
    from dynamictree.plant.capture import moving_part

    mesh = with_mesh(owned, ready, spectrum_id)
    if ready.gaussians is None:
        capture, choice = load_source_cloud(owned, spectrum_id)
        binding = bind(capture.cloud, mesh, mask=moving_part(capture, choice))
        rows = np.flatnonzero(binding.moving).astype(np.int32)
        cloud = binding.cloud.subset(rows).with_sh_degree(0)
        moving = replace(binding, cloud=cloud, face_of=binding.face_of[rows], weights=binding.weights[rows])
        ready.gaussians = MovingGaussians(rows, Deformer(moving))
    return ready.gaussians
