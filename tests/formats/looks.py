"""What a glTF document shows, as tests of artists' models compare it."""

import copy
import io
from collections.abc import Callable
from typing import Any

import numpy as np

from dynamictree.formats.gltf.template import open_document
from dynamictree.formats.tensors.bundle import read_mesh_bundle, write_bundle
from dynamictree.mesh import TriangleMesh, unit_vectors
from tests.formats import artists
from tests.formats.artists import Document, document_of
from tests.formats.meshes import written

MODELS = [
    *(artists.wooded, artists.repeated, artists.skinned, artists.morphing, artists.quantised),
    *(artists.instanced, artists.compressed),
]


def coefficients_of(mesh: TriangleMesh, num_frequencies: int = 4) -> np.ndarray:
    rng = np.random.default_rng(0)
    parts = rng.normal(0, 0.02 * mesh.height_m, (mesh.num_vertices, num_frequencies, 6)).astype(np.float32)
    return parts.view(np.complex64)


def returned(mesh: TriangleMesh) -> Document:
    """What writers add a motion to."""
    return document_of(written(open_document(mesh).finish))


def looks(document: Document) -> dict[str, Any]:
    """All that the document shows, without indices: content in the place of each accessor, view and image."""
    root = copy.deepcopy(document.root)

    def values(index: int) -> tuple[Any, ...]:
        entry = root["accessors"][index]
        described = {name: value for name, value in entry.items() if name not in ("bufferView", "byteOffset")}
        return described, document.accessor(index).tobytes() if "bufferView" in entry else b""

    for mesh in root["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["attributes"] = {name: values(index) for name, index in primitive["attributes"].items()}
            if "indices" in primitive:
                primitive["indices"] = values(primitive["indices"])
            primitive["targets"] = [{n: values(i) for n, i in t.items()} for t in primitive.get("targets", [])]
    for node in root["nodes"]:
        if "mesh" in node:
            node["mesh"] = root["meshes"][node["mesh"]]
    for skin in root.get("skins", []):
        skin["inverseBindMatrices"] = values(skin["inverseBindMatrices"])
    for animation in root.get("animations", []):
        for sampler in animation["samplers"]:
            sampler |= {name: values(sampler[name]) for name in ("input", "output")}
    for index, image in enumerate(root.get("images", [])):
        content = document.image(index)
        uri = image.pop("uri", None)
        image |= {"content": content, "name": image.get("name", uri)}
        image.pop("bufferView", None)
        image.pop("mimeType", None)
    for name in ("meshes", "accessors", "bufferViews", "buffers"):
        root.pop(name, None)
    return root


def standing(document: Document, moved: Callable[[int, dict[str, Any]], np.ndarray | float]) -> np.ndarray:
    """Vertices of the scene with what is added to the positions of each node's primitives, +Z up."""
    root = document.root
    world: dict[int, np.ndarray] = {}

    def visit(index: int, above: np.ndarray) -> None:
        world[index] = above @ local_matrix(root["nodes"][index])
        for child in root["nodes"][index].get("children", []):
            visit(child, world[index])

    for first in root["scenes"][root["scene"]]["nodes"]:
        visit(first, np.eye(4))
    vertices = []
    for index, matrix in world.items():
        node = root["nodes"][index]
        if "mesh" not in node:
            continue
        shares = root["meshes"][node["mesh"]].get("weights", [])
        for primitive in root["meshes"][node["mesh"]]["primitives"]:
            if primitive.get("mode", 4) != 4:
                continue
            position = floats(document, primitive["attributes"]["POSITION"]) + moved(index, primitive)
            for target, share in zip(primitive.get("targets", []), shares, strict=False):
                position += share * floats(document, target["POSITION"])
            place = np.tile(matrix[:3], (len(position), 1, 1))
            if "skin" in node:
                skin = root["skins"][node["skin"]]
                bind = document.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
                joints = np.stack([world[j] for j in skin["joints"]]) @ bind
                chosen = document.accessor(primitive["attributes"]["JOINTS_0"])
                weights = document.accessor(primitive["attributes"]["WEIGHTS_0"])
                weights = weights / 255 if weights.dtype == np.uint8 else weights
                place = np.einsum("nj,njab->nab", weights, joints[chosen])[:, :3]
            vertices.append(np.einsum("nij,nj->ni", place[:, :, :3], position) + place[:, :, 3])
    x, y, z = np.concatenate(vertices).T
    return np.stack([x, -z, y], axis=1)


def floats(document: Document, index: int) -> np.ndarray:
    stored = document.accessor(index)
    return stored / np.iinfo(stored.dtype).max if stored.dtype.kind == "i" else stored.astype(np.float64)


def local_matrix(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) + 2 * w * cross + 2 * cross @ cross) * node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def through_the_parser(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh as a job's worker gets it."""
    return read_mesh_bundle(io.BytesIO(written(write_bundle, mesh)), with_source=True)


def angles_rad(normals: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Angle between two directions per vertex, as exact for small ones as for large ones."""
    a, b = unit_vectors(normals).astype(np.float64), unit_vectors(others).astype(np.float64)
    return np.asarray(2 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1)))
