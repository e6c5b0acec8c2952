"""A motion as a GLB with a skeleton: joints that turn, four of them a vertex, keys of one period in 16 bits.

What engines play most cheaply. The file tells in its `asset.extras` how far it is from the motion.
"""

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from jaxtyping import Int32

from dynamictree.byte_stream import ByteWriter
from dynamictree.formats.gltf.webp import webp_textures
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.skin import Skin, SkinSummary
from dynamictree.up_axis import up_rotation

_FIRST = 2  # node of joint 0: after the mesh and the skeleton


def write_skinned_glb(
    mesh: TriangleMesh, skin: Skin, summary: SkinSummary, stream: ByteWriter, *, fps: float, as_webp: bool = False
) -> None:
    """Write one period with linear keys, the last equal to the first.

    `as_webp` writes textures as WebP where that is smaller.
    """
    writer = GlbWriter(extras=asdict(summary))
    used = skin.weights > 0
    attributes = {
        "JOINTS_0": writer.add_accessor(
            np.where(used, skin.rows, 0).astype(np.uint8 if len(skin.parent) <= 256 else np.uint16),
            target=VERTEX_BUFFER,
        ),
        "WEIGHTS_0": writer.add_accessor(
            np.rint(255 * skin.weights).astype(np.uint8), target=VERTEX_BUFFER, normalized=True
        ),
    }
    add_mesh(writer, mesh, more_attributes=attributes)
    writer.append("nodes", {"mesh": 0, "skin": 0, "name": "tree"})
    rest = _rest(skin)
    _add_joints(writer, skin.parent, rest)
    _add_skin(writer, rest)
    writer.append("scenes", {"nodes": [0, 1]})
    _add_sway(writer, skin, fps)
    if as_webp:
        webp_textures(writer)
    writer.finish(stream)


def write_joint_meshes_glb(
    parts: Mapping[int, TriangleMesh], skin: Skin, stream: ByteWriter, *, fps: float, name: str = "part"
) -> None:
    """Write meshes that joints carry, each as a node `NAME_joint_n` below its joint, with the motion of the joints."""
    writer = GlbWriter()
    writer.append("nodes", {"name": "tree"})
    rest = _rest(skin)
    _add_joints(writer, skin.parent, rest)
    for joint, mesh in parts.items():
        add_mesh(writer, mesh.with_vertices(mesh.vertices - skin.joint_m[joint]))
        node = writer.append("nodes", {"mesh": len(writer.root["meshes"]) - 1, "name": f"{name}_joint_{joint}"})
        writer.root["nodes"][_FIRST + joint].setdefault("children", []).append(node)
    writer.append("scenes", {"nodes": [1]})
    _add_sway(writer, skin, fps)
    writer.finish(stream)


def joint_name(joint: int) -> str:
    """Name of a joint's node."""
    return f"joint_{joint}"


def _rest(skin: Skin) -> np.ndarray:
    """Where the joints are at rest, in the file's axes."""
    return np.asarray(skin.joint_m.astype(np.float64) @ up_rotation("+Y"))


def _add_sway(writer: GlbWriter, skin: Skin, fps: float) -> None:
    w, x, y, z = np.moveaxis(skin.turns, 2, 0)
    turns = np.rint(32767 * np.stack([x, z, -y, w], axis=2)).astype(np.int16)  # of the file's axes, in its order
    looped = np.concatenate([turns, turns[:1]])
    clock = writer.add_accessor((np.arange(len(looped)) / fps).astype(np.float32)[:, None], bounds=True)
    moving = np.flatnonzero(turns[:, :, :3].any(axis=(0, 2))).tolist()  # parents carry the others as at rest
    view = writer.add_view(np.ascontiguousarray(looped[:, moving].swapaxes(0, 1)).tobytes())
    keys = {"bufferView": view, "componentType": 5122, "normalized": True, "count": len(looped), "type": "VEC4"}
    samplers, channels = list[object](), list[object]()
    for number, joint in enumerate(moving):
        output = writer.append("accessors", keys | {"byteOffset": 8 * len(looped) * number})
        samplers.append({"input": clock, "output": output})
        channels.append({"sampler": number, "target": {"node": _FIRST + joint, "path": "rotation"}})
    writer.append("animations", {"name": "sway", "samplers": samplers, "channels": channels})


def _add_joints(writer: GlbWriter, parent: Int32[np.ndarray, " B"], rest: np.ndarray) -> None:
    """A node per joint under one that holds them all."""
    children: list[list[int]] = [[] for _ in parent]
    for joint, above in enumerate(parent.tolist()):
        if above >= 0:
            children[above].append(_FIRST + joint)
    roots = [_FIRST + joint for joint in np.flatnonzero(parent < 0).tolist()]
    writer.append("nodes", {"name": "skeleton", "children": roots})
    offset = rest - np.where(parent[:, None] >= 0, rest[parent], 0)
    for joint, below in enumerate(children):
        node: dict[str, object] = {"name": joint_name(joint), "translation": offset[joint].round(7).tolist()}
        writer.append("nodes", node | ({"children": below} if below else {}))


def _add_skin(writer: GlbWriter, rest: np.ndarray) -> None:
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(rest), 1, 1))
    inverse[:, 3, :3] = -rest  # column-major, as glTF has it
    matrices = writer.add_accessor(inverse.reshape(-1, 16))
    joints = list(range(_FIRST, _FIRST + len(rest)))
    writer.append("skins", {"inverseBindMatrices": matrices, "joints": joints, "skeleton": 1})
