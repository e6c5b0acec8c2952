"""The document that a skin is added to: the mesh's source document, or a new one."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float64

from dynamictree.formats.gltf.scene import world_transforms
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import SourceGltf, TriangleMesh
from dynamictree.skin import Skin
from dynamictree.up_axis import up_rotation


def open_document(mesh: TriangleMesh) -> GlbWriter:
    """Return the document of the mesh's source, upright and in metres; without one, `plain_document`."""
    if mesh.gltf is None:
        return plain_document(mesh)
    chunks = list(mesh.gltf.binary)
    writer = GlbWriter(root=json.loads(mesh.gltf.document), chunks=chunks, num_bytes=sum(map(len, chunks)))
    if mesh.source.up_axis != "+Y" or mesh.source.scale != 1.0:
        _add_upright_root(writer.root, mesh.source.scale * up_rotation(mesh.source.up_axis))
    return writer


def plain_document(mesh: TriangleMesh, *, as_webp: bool = False) -> GlbWriter:
    """Return a document of one mesh in one node, +Y up and in metres."""
    writer = GlbWriter()
    add_mesh(writer, mesh, as_webp=as_webp)
    writer.append("nodes", {"mesh": 0, "name": "tree"})
    return writer


def can_carry_joints(source: SourceGltf) -> bool:
    """Whether joints can be attached: no skin, no instancing, no levels of detail and no Draco in the document."""
    otherwise = (b"EXT_mesh_gpu_instancing", b"KHR_draco_mesh_compression", b"MSFT_lod")
    root = json.loads(source.document)
    skinned = any("mesh" in node and "skin" in node for node in root["nodes"])
    return not skinned and bool(root.get("scenes")) and not any(name in source.document for name in otherwise)


def attach_joints(
    writer: GlbWriter, source: SourceGltf, skin: Skin, skin_for: Callable[[Float64[np.ndarray, "4 4"]], int]
) -> list[int]:
    """Attach joints and weights to the moving meshes of a source's document; return their new nodes, for the scene.

    `skin_for` adds a skin for meshes that a matrix places in the scene, and returns its index.
    """
    root, world = writer.root, world_transforms(writer.root)
    by_node: dict[int, dict[int, slice]] = {}
    for node, primitive, first, count in source.primitives.tolist():
        by_node.setdefault(node, {})[primitive] = slice(first, first + count)
    skins: dict[bytes, int] = {}
    nodes = list[int]()
    for node, rows_of in by_node.items():
        if not any((skin.rows[rows] * skin.weights[rows]).any() for rows in rows_of.values()):
            continue
        for number, primitive in enumerate(_own_mesh(writer, node)["primitives"]):
            count = root["accessors"][primitive["attributes"]["POSITION"]]["count"]
            primitive["attributes"] |= add_mesh_joints(writer, skin, rows_of.get(number), count)
        key = world[node].tobytes()
        if key not in skins:
            skins[key] = skin_for(world[node])
        entry = root["nodes"][node]
        fields = {name: entry.pop(name) for name in ("mesh", "weights") if name in entry}
        nodes.append(writer.append("nodes", {"name": "tree", "skin": skins[key], **fields}))
    return nodes


def add_mesh_joints(writer: GlbWriter, skin: Skin, rows: slice | None = slice(None), count: int = 0) -> dict[str, int]:
    """Add joints and weights of the vertices `rows`; if None, of `count` vertices on joint 0, which never moves."""
    if rows is None:
        joints, weights = np.zeros((count, 4), np.int32), np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    else:
        weights = skin.weights[rows]
        joints = np.where(weights > 0, skin.rows[rows], 0)
    small = np.uint8 if len(skin.parent) <= np.iinfo(np.uint8).max + 1 else np.uint16
    shares = np.rint(255 * weights).astype(np.uint8)
    return {
        "JOINTS_0": writer.add_accessor(joints.astype(small), target=VERTEX_BUFFER),
        "WEIGHTS_0": writer.add_accessor(shares, target=VERTEX_BUFFER, normalized=True),
    }


def _own_mesh(writer: GlbWriter, node: int) -> dict[str, Any]:
    """Return the node's mesh; a copy of it if other nodes use it too."""
    root = writer.root
    index = root["nodes"][node]["mesh"]
    if sum(other.get("mesh") == index for other in root["nodes"]) > 1:
        root["nodes"][node]["mesh"] = writer.append("meshes", json.loads(json.dumps(root["meshes"][index])))
    mesh: dict[str, Any] = root["meshes"][root["nodes"][node]["mesh"]]
    return mesh


def _add_upright_root(root: dict[str, Any], to_z_up: Float64[np.ndarray, "3 3"]) -> None:
    """Put the scene below a new node that turns and scales it to metres and +Y up."""
    scene = root["scenes"][root.get("scene", 0)]
    matrix = np.eye(4)
    matrix[:3, :3] = up_rotation("+Y").T @ to_z_up
    root["nodes"].append({"name": "upright", "children": scene["nodes"], "matrix": matrix.T.ravel().tolist()})
    scene["nodes"] = [len(root["nodes"]) - 1]
