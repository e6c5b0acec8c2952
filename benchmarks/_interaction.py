"""Scene of the interaction benchmarks: a generated tree with many vertices and Gaussians."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamictree.gaussian.binding import Binding, bind_to_faces
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.bones import turns_of
from dynamictree.modal.interactive_tree import InteractiveTree
from dynamictree.modal.system import ModalSystem, modal_system
from dynamictree.rig.pose import carried, poses
from dynamictree.rig.rig import rig_of
from dynamictree.spectrum import SparseVoxelSpectrum
from lab.dataset.sample import make_sample, voxel_spectrum

SEED, SPECIES = 9, "columnar"
NUM_VERTICES = 100_000
NUM_GAUSSIANS = 500_000


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One tree, its spectrum at 128³, and its refined mesh."""

    mesh: TriangleMesh
    spectrum: SparseVoxelSpectrum
    system: ModalSystem

    def tree(self) -> InteractiveTree:
        """Return the tree with its rig."""
        return InteractiveTree(self.system, rig_of(self.mesh, self.spectrum), self.mesh)


def scene() -> Scene:
    sample = make_sample(SEED, SPECIES)
    _, spectrum = voxel_spectrum(sample)
    mesh = _subdivided(sample.mesh)
    while mesh.num_vertices < NUM_VERTICES:
        mesh = _split(mesh, min(NUM_VERTICES, mesh.num_vertices + mesh.num_faces))
    return Scene(mesh=mesh, spectrum=spectrum, system=modal_system(spectrum))


def bent_by(tree: InteractiveTree) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function from coordinates [1, M] to the displacement of the vertices [N, 3] [m], as of /v1/interact."""
    assert tree.rig is not None
    assert tree.mesh is not None
    rig, vertices, still = tree.rig, tree.mesh.vertices, np.zeros((len(tree.joints.parent), 3))

    def displacement(q: np.ndarray) -> np.ndarray:
        turns = turns_of(tree.bones, [None], q).astype(np.float32)
        return carried(
            rig.skeleton, tree.joints.bent(poses(rig.skeleton, turns[None]), still), 0, vertices, rig.vertices
        )

    return displacement


def gaussians_on(mesh: TriangleMesh, count: int = NUM_GAUSSIANS, *, in_face_order: bool = True) -> Binding:
    """Return Gaussians that are distributed over the surface by area, bound to faces, in their order or shuffled."""
    rng = np.random.default_rng(1)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    faces = rng.choice(len(area), count, p=area / area.sum()).astype(np.int32)
    if in_face_order:
        faces.sort()
    weights = rng.dirichlet([1, 1, 1], count)
    quaternions = rng.normal(size=(count, 4))
    cloud = GaussianCloud(
        means=np.einsum("gc,gcx->gx", weights, corners[faces]).astype(np.float32),
        quaternions=(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.002, 0.02, (count, 3)).astype(np.float32),
        opacity=np.full(count, 0.9, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )
    return bind_to_faces(cloud, mesh, faces, weights.astype(np.float32))


def _subdivided(mesh: TriangleMesh) -> TriangleMesh:
    """Halve every edge and split every face into four."""
    edges = edges_of(mesh.faces)
    middle = (mesh.vertices[edges[:, 0]] + mesh.vertices[edges[:, 1]]) / 2
    keys = edges[:, 0].astype(np.int64) << 32 | edges[:, 1]

    def between(a: int, b: int) -> np.ndarray:
        pair = np.sort(mesh.faces[:, [a, b]], axis=1).astype(np.int64)
        return np.searchsorted(keys, pair[:, 0] << 32 | pair[:, 1]) + mesh.num_vertices

    ab, bc, ca = between(0, 1), between(1, 2), between(2, 0)
    a, b, c = mesh.faces.T
    faces = [np.stack(three, axis=1) for three in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices, middle]).astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
    )


def _split(mesh: TriangleMesh, num_vertices: int) -> TriangleMesh:
    """Split the largest faces into three at their centre, up to a number of vertices."""
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    order = np.argsort(-area, kind="stable")
    cut, whole = np.split(order, [num_vertices - mesh.num_vertices])
    middle = np.arange(mesh.num_vertices, num_vertices)
    a, b, c = mesh.faces[cut].T
    faces = [np.stack(three, axis=1) for three in ((a, b, middle), (b, c, middle), (c, a, middle))]
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices, corners[cut].mean(axis=1)]).astype(np.float32),
        faces=np.concatenate([mesh.faces[whole], *faces]).astype(np.int32),
    )
