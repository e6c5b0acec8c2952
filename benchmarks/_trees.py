"""Trees for benchmarks: one of each kind, and the demo tree with fewer or more vertices."""

from dataclasses import replace

import numpy as np

from benchmarks.golden_motion import SAMPLES
from dynamictree.commands.input_files import read_source
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.requests import CloudParams, Reading
from lab.dataset.sample import make_sample
from recipes.demo import SEED, SPECIES

KINDS = (
    "round-broadleaf",
    "conical-conifer",
    "palm",
    "mesh/tree-lime.glb",
    "mesh/quaternius_common_tree/CommonTree_2.obj",
)
KINDS += ("../cases/potted.glb", "splat/tree_10k.splat", "scan/tls_tree_1.txt")
"""Generated trees, and files under DYNAMICTREE_SAMPLES: cards, a crown as one surface, a pot, a splat, a scan."""


def tree_of_kind(name: str) -> TriangleMesh | None:
    """Return the moving mesh of a kind, as one primitive; None if its file is missing."""
    if "/" not in name:
        return make_sample(3, name).mesh
    if not (SAMPLES / name).exists():
        return None
    mesh, _ = read_source(SAMPLES / name, Reading(), choice=CloudParams(), mask=None, beside=None)
    return replace(mesh, gltf=None)


def demo_mesh(num_vertices: int | None = None) -> TriangleMesh:
    """Return the demo tree, cut to its lowest vertices or with its longest edges halved, with about `num_vertices`."""
    mesh = make_sample(SEED, SPECIES).mesh
    mesh = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces)
    if num_vertices is None:
        return mesh
    if num_vertices < mesh.num_vertices:
        return _lowest(mesh, num_vertices)
    while mesh.num_vertices < num_vertices:
        mesh = _split_longest_edges(mesh, num_vertices - mesh.num_vertices)
    return mesh


def _lowest(mesh: TriangleMesh, num_vertices: int) -> TriangleMesh:
    below = np.sort(mesh.vertices[:, 2])[num_vertices - 1]
    faces = mesh.faces[(mesh.vertices[mesh.faces, 2] <= below).all(axis=1)]
    used, corners = np.unique(faces, return_inverse=True)
    return TriangleMesh(vertices=mesh.vertices[used], faces=corners.reshape(-1, 3).astype(np.int32))


def _split_longest_edges(mesh: TriangleMesh, most: int) -> TriangleMesh:
    """Split faces at the middle of their longest edges, each face at one edge at most."""
    edges = edges_of(mesh.faces)
    length = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    corners = np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=2)  # [F, 3, 2]
    keys = np.sort(corners, axis=2).astype(np.int64) @ np.array([mesh.num_vertices, 1])
    edge_keys = np.sort(edges, axis=1).astype(np.int64) @ np.array([mesh.num_vertices, 1])
    sorted_keys = np.argsort(edge_keys)
    edge = sorted_keys[np.searchsorted(edge_keys[sorted_keys], keys)]  # [F, 3]
    longest = length[edge].argmax(axis=1)
    own = edge[np.arange(len(edge)), longest]  # longest edge of each face
    agree = np.bincount(own, minlength=len(edges)) == np.bincount(edge.ravel(), minlength=len(edges))
    chosen = np.flatnonzero(agree)  # edges longest in all adjacent faces, so that no face gets an extra vertex
    chosen = chosen[np.argsort(-length[chosen], kind="stable")][:most]
    middle = np.full(len(edges), -1, np.int64)
    middle[chosen] = mesh.num_vertices + np.arange(len(chosen))
    vertices = np.concatenate([mesh.vertices, mesh.vertices[edges[chosen]].mean(axis=1)]).astype(np.float32)
    split = middle[own] >= 0
    rolled = np.take_along_axis(mesh.faces, (longest[:, None] + np.arange(3)) % 3, axis=1)[split]
    halves = middle[own[split]]
    faces = np.concatenate(
        [
            mesh.faces[~split],
            np.column_stack([rolled[:, 0], halves, rolled[:, 2]]),
            np.column_stack([halves, rolled[:, 1], rolled[:, 2]]),
        ]
    )
    return TriangleMesh(vertices=vertices, faces=faces.astype(np.int32))
