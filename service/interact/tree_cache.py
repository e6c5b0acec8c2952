"""Trees of callers; recently used ones stay in memory.

Functions raise NotFoundError or GoneError if a spectrum does not exist, or it or its asset has expired.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.force import Contact
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.system import ModalSystem, modal_system, with_physics
from dynamictree.requests import ExportParams, SwingParams
from service.http.problems import ProblemError
from service.interact.ready_tree import BoundGaussians, ReadyTree
from service.interact.stored_trees import (
    load_result,
    load_source_cloud,
    load_source_mesh,
    load_spectrum,
    source_of,
    spectrum_artifact,
)
from service.services import Owned

if TYPE_CHECKING:
    from dynamictree.rig.flutter import Flutter
    from dynamictree.rig.rig import Rig


@dataclass(frozen=True)
class ServedTree:
    """The tree of a spectrum for one caller. Mesh, rig and Gaussians are loaded on demand, and then stay in memory."""

    owned: Owned
    id: str  # id of the spectrum
    ready: ReadyTree

    def system(self, params: SwingParams) -> ModalSystem:
        """Return the modal system with the mass, damping and frequency of a request."""
        return with_physics(
            self.ready.tree.system,
            mass_kg=params.mass_kg,
            damping_ratio=params.damping_ratio,
            frequency_hz=params.frequency_hz,
            foliage=params.foliage,
        )

    def mesh(self) -> TriangleMesh:
        """Return the source mesh."""
        source_of(self.owned, self.id)  # raises GoneError if it has expired
        if self.ready.mesh is None:
            self.ready.mesh = load_source_mesh(self.owned, self.id)
        return self.ready.mesh

    def vertex_contact(self, vertex: int, radius_m: float) -> Contact:
        """Return the contact of a force at a vertex."""
        mesh = self.mesh()
        if vertex >= mesh.num_vertices:
            detail = f"vertex {vertex} does not exist; the mesh has vertices 0 to {mesh.num_vertices - 1}"
            raise ProblemError("invalid-input", detail)
        return self.with_rig().contact_at_vertex(mesh.vertices, vertex, radius_m=radius_m)

    def flutter(self) -> "Flutter":
        """Return the flutter of the rig's bones, of the size that the job's files have."""
        from dynamictree.rig.flutter import flutter_of  # imports numba

        size = ExportParams.part_of(source_of(self.owned, self.id)[0].params).flutter
        return flutter_of(self.rig(), load_spectrum(self.owned, self.id), size)

    def rig(self) -> "Rig":
        """Return the rig: that of the job's products, or computed if no job has needed one yet."""
        from dynamictree.formats.tensors.rig import read_rig  # imports numba
        from dynamictree.rig.rig import rig_of

        if self.ready.tree.rig is None:
            mesh = self.mesh()
            stream = load_result(self.owned, self.id, "rig")
            rig = rig_of(mesh, load_spectrum(self.owned, self.id)) if stream is None else read_rig(stream)
            self.ready.tree = InteractiveTree(self.ready.tree.system, rig, mesh)
            return rig
        return self.ready.tree.rig

    def with_rig(self) -> InteractiveTree:
        """Return the tree with its rig, which localities, bends and moving points require."""
        self.rig()
        return self.ready.tree

    def gaussians(self) -> BoundGaussians:
        """Return the moving Gaussians of the source cloud, bound to its mesh."""
        from dynamictree.gaussian.binding import bind
        from dynamictree.gaussian.deform import Deformer
        from dynamictree.plant.capture import moving_part

        mesh = self.mesh()
        if self.ready.gaussians is None:
            capture, choice = load_source_cloud(self.owned, self.id)
            binding = bind(capture.cloud, mesh, mask=moving_part(capture, choice))
            rows = np.flatnonzero(binding.moving).astype(np.int32)
            cloud = binding.cloud.subset(rows).with_sh_degree(0)
            moving = replace(binding, cloud=cloud, face_of=binding.face_of[rows], weights=binding.weights[rows])
            self.ready.gaussians = BoundGaussians(rows, Deformer(moving))
        return self.ready.gaussians


def system_facts(system: ModalSystem) -> dict[str, object]:
    """Return the properties of a modal system that clients need."""
    return {
        "frequencies_hz": [0.0, *(system.omega / (2 * np.pi)).tolist()],
        "damping_ratio": float(system.damping_ratio[0]),
        "foliage": system.foliage,
        "modal_mass_kg_m2": system.modal_mass,
    }


def served_tree(owned: Owned, spectrum_id: str) -> ServedTree:
    """Return the tree of a spectrum, cached or loaded."""
    tree = living_tree(owned, spectrum_id)
    if tree is None:
        artifact = spectrum_artifact(owned, spectrum_id)
        ready = ReadyTree(InteractiveTree(modal_system(load_spectrum(owned, spectrum_id))), artifact.expires_at)
        owned.services.trees.put(_key(owned, spectrum_id), ready)
        tree = ServedTree(owned, spectrum_id, ready)
    return tree


def living_tree(owned: Owned, spectrum_id: str) -> ServedTree | None:
    """Return the cached tree of a spectrum, without a database query; None if there is none or it has expired."""
    ready = owned.services.trees.get(_key(owned, spectrum_id))
    if ready is None or owned.store.clock() >= ready.expires_at:
        return None
    return ServedTree(owned, spectrum_id, ready)


def _key(owned: Owned, spectrum_id: str) -> str:
    """Return the cache key, which includes the owner."""
    return f"{owned.caller.owner or ''}/{spectrum_id}"
