"""Nodes of a glTF scene: placed meshes, instances, and skins at rest."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from dynamictree.errors import FormatError
from dynamictree.formats.gltf.document import GltfDocument, accessor_layout
from dynamictree.formats.json_fields import (
    JsonObject,
    index_field,
    index_list,
    numbers_field,
    object_field,
    object_list,
)
from dynamictree.rotation import quaternion_matrices

_INSTANCE_WIDTHS = {"TRANSLATION": 3, "ROTATION": 4, "SCALE": 3}


@dataclass(frozen=True, kw_only=True)
class MeshInstance:
    """One mesh of the scene at one place; `joints` are the matrices of its skin, which replace `transform`."""

    node: int
    path: str  # names from the root to the node, joined by slashes
    mesh: JsonObject
    weighs: JsonObject  # node or mesh with the weights of morph targets
    transform: Float64[np.ndarray, "4 4"]
    joints: Float64[np.ndarray, "J 4 4"] | None


def mesh_instances(document: GltfDocument) -> Iterator[MeshInstance]:
    """Yield the meshes of the default scene, parents before children, in the order of the file.

    Raises:
        FormatError: a node that is its own ancestor or has two parents, or an invalid matrix.
    """
    nodes, meshes = object_list(document.root, "nodes"), object_list(document.root, "meshes")
    skins = object_list(document.root, "skins")
    world = world_transforms(document.root)
    paths = _paths(nodes, world.keys())
    _refuse_many_instances(document, [nodes[index] for index in world])
    for index, transform in world.items():
        mesh = index_field(nodes[index], "mesh", meshes, "meshes")
        if mesh is None:
            continue
        skin = index_field(nodes[index], "skin", skins, "skins")
        joints = None if skin is None else _joint_matrices(document, skins[skin], world)
        places = _instance_transforms(document, nodes[index])
        for placed in np.eye(4)[None] if places is None else places:
            yield MeshInstance(
                node=index,
                path=paths[index],
                mesh=meshes[mesh],
                weighs=nodes[index] if "weights" in nodes[index] else meshes[mesh],
                transform=transform @ placed,
                joints=joints,
            )


def _paths(nodes: list[JsonObject], order: Iterable[int]) -> dict[int, str]:
    """Return the path of names from the root to each node, parents first; a slash in a name becomes a space."""
    most_names = 16  # names per path
    above = {child: index for index in order for child in index_list(nodes[index], "children", nodes)}
    names: dict[int, tuple[str, ...]] = {}
    for index in order:
        name = nodes[index].get("name")
        own = (name.strip().replace("/", " ")[:200],) if isinstance(name, str) and name.strip() else ()
        names[index] = ((names[above[index]] if index in above else ()) + own)[-most_names:]
    return {index: "/".join(path) for index, path in names.items()}


def world_transforms(root: JsonObject) -> dict[int, Float64[np.ndarray, "4 4"]]:
    """Return the world matrix of each node of the scene, parents first.

    Raises:
        FormatError: a node is reached twice.
    """
    nodes, scenes = object_list(root, "nodes"), object_list(root, "scenes")
    scene = index_field(root, "scene", scenes, "scenes")
    if scenes:
        roots = index_list(scenes[scene or 0], "nodes", nodes)
    else:
        children = {child for node in nodes for child in index_list(node, "children", nodes)}
        roots = [index for index in range(len(nodes)) if index not in children]
    world: dict[int, Float64[np.ndarray, "4 4"]] = {}
    waiting = [(index, np.eye(4)) for index in reversed(roots)]
    while waiting:
        index, above = waiting.pop()
        if index in world:
            raise FormatError(f"node {index} is reached twice, from two parents or from below itself; nodes are a tree")
        world[index] = above @ local_transform(nodes[index])
        waiting += [(child, world[index]) for child in reversed(index_list(nodes[index], "children", nodes))]
    return world


def local_transform(node: JsonObject) -> Float64[np.ndarray, "4 4"]:
    """Return a node's local matrix."""
    if "matrix" in node:
        return np.array(numbers_field(node, "matrix", 16, ())).reshape(4, 4, order="F")  # column-major
    if not node.keys() & {"translation", "rotation", "scale"}:
        return np.eye(4)
    local: Float64[np.ndarray, "4 4"] = _compose(
        np.array([numbers_field(node, "translation", 3, (0.0, 0.0, 0.0))]),
        np.array([numbers_field(node, "rotation", 4, (0.0, 0.0, 0.0, 1.0))]),
        np.array([numbers_field(node, "scale", 3, (1.0, 1.0, 1.0))]),
    )[0]
    return local


def _refuse_many_instances(document: GltfDocument, nodes: list[JsonObject]) -> None:
    """Check the number of instances by the counts of the accessors, before any is read."""
    max_instances = 200_000  # instances of EXT_mesh_gpu_instancing in a scene; each is a matrix and a part of the mesh
    total = 0
    for node in nodes:
        extension = object_field(object_field(node, "extensions"), "EXT_mesh_gpu_instancing")
        attributes = object_field(extension, "attributes")
        accessors = [index_field(attributes, name, document.accessors, "accessors") for name in _INSTANCE_WIDTHS]
        layouts = [accessor_layout(document.accessors[a], f"accessors[{a}]") for a in accessors if a is not None]
        total += max((count for count, _, _ in layouts), default=0)
    if total > max_instances:
        raise FormatError(f"EXT_mesh_gpu_instancing has {total:,} places; at most {max_instances:,} are allowed")


def _instance_transforms(document: GltfDocument, node: JsonObject) -> Float64[np.ndarray, "I 4 4"] | None:
    """Return the matrices of EXT_mesh_gpu_instancing; None for a plain node."""
    extension = object_field(object_field(node, "extensions"), "EXT_mesh_gpu_instancing")
    attributes = object_field(extension, "attributes")
    parts = {}
    for name, width in _INSTANCE_WIDTHS.items():
        accessor = index_field(attributes, name, document.accessors, "accessors")
        if accessor is not None:
            parts[name] = document.accessor(accessor).astype(np.float64)
            if parts[name].shape[1] != width:
                raise FormatError(f"EXT_mesh_gpu_instancing has {name} of {parts[name].shape[1]} numbers, not {width}")
    if not parts:
        return None
    count = {len(part) for part in parts.values()}
    if len(count) != 1:
        raise FormatError(f"EXT_mesh_gpu_instancing has attributes of different lengths, {sorted(count)}")
    (length,) = count
    return _compose(
        parts.get("TRANSLATION", np.zeros((length, 3))),
        parts.get("ROTATION", np.tile([0.0, 0.0, 0.0, 1.0], (length, 1))),
        parts.get("SCALE", np.ones((length, 3))),
    )


def _compose(
    translation: Float64[np.ndarray, "I 3"], rotation: Float64[np.ndarray, "I 4"], scale: Float64[np.ndarray, "I 3"]
) -> Float64[np.ndarray, "I 4 4"]:
    """Compose matrices: translation · rotation · scale; quaternions are xyzw."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    if not (length > 0).all():
        raise FormatError("a rotation of the file is a quaternion of length 0")
    matrices = np.tile(np.eye(4), (len(translation), 1, 1))
    matrices[:, :3, :3] = quaternion_matrices((rotation / length)[:, [3, 0, 1, 2]]) * scale[:, None, :]
    matrices[:, :3, 3] = translation
    return matrices


def _joint_matrices(
    document: GltfDocument, skin: JsonObject, world: dict[int, Float64[np.ndarray, "4 4"]]
) -> Float64[np.ndarray, "J 4 4"]:
    joints = index_list(skin, "joints", object_list(document.root, "nodes"))
    if not joints or not set(joints) <= set(world):
        raise FormatError("a skin has no joints, or joints that are not in the scene")
    placed = np.stack([world[joint] for joint in joints])
    inverse = index_field(skin, "inverseBindMatrices", document.accessors, "accessors")
    if inverse is None:
        return placed
    bind = document.accessor(inverse).astype(np.float64)
    if bind.shape != (len(joints), 16):
        raise FormatError(f"a skin has {len(joints)} joints and inverse bind matrices of shape {list(bind.shape)}")
    return placed @ bind.reshape(-1, 4, 4).transpose(0, 2, 1)
