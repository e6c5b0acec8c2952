"""A motion as a GLB with a skeleton: joints that turn and slide, four of them a vertex, keys of one period.

What engines play most cheaply, at the price of an error, which the file tells in its `asset.extras`.
"""

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from jaxtyping import Int32

from dynamictree.byte_stream import ByteWriter
from dynamictree.formats.gltf.webp import webp_textures
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.rotation import matrix_quaternions
from dynamictree.skin import Skin, SkinSummary
from dynamictree.up_axis import up_rotation

_STILL_M = 1e-6
_FIRST = 2  # node of joint 0: after the mesh and the skeleton


def write_skinned_glb(
    mesh: TriangleMesh, skin: Skin, summary: SkinSummary, stream: ByteWriter, *, fps: float, as_webp: bool = False
) -> None:
    """Write one period with T + 1 linear keys, the last equal to the first; exact at the keys, as the skin has them.

    `as_webp` writes textures as WebP where that is smaller.
    """
    writer = GlbWriter(extras=asdict(summary))
    used = skin.weights > 0
    attributes = {
        "JOINTS_0": writer.add_accessor(np.where(used, skin.rows, 0).astype(np.uint16), target=VERTEX_BUFFER),
        "WEIGHTS_0": writer.add_accessor(np.where(used, skin.weights, 0).astype(np.float32), target=VERTEX_BUFFER),
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
    rest, turn = _rest(skin), up_rotation("+Y")  # file to +Z up
    turned = turn.T @ skin.rotation.astype(np.float64) @ turn  # [T, B, 3, 3]
    place = np.einsum("tbij,bj->tbi", turned, rest) + skin.translation_m.astype(np.float64) @ turn
    rotation, translation = relative_to_parents(skin.parent, turned, place)
    times = (np.arange(len(place) + 1) / fps).astype(np.float32)
    clock = writer.add_accessor(times[:, None], bounds=True)
    samplers, channels = list[object](), list[object]()
    for joint in range(len(skin.parent)):
        keys = {"rotation": steady(matrix_quaternions(rotation[:, joint])), "translation": translation[:, joint]}
        for path, values in keys.items():
            if path == "translation" and np.ptp(values, axis=0).max() < _STILL_M:
                continue  # its parent carries it, as at rest
            looped = np.concatenate([values, values[:1]]).astype(np.float32)
            channels.append({"sampler": len(samplers), "target": {"node": _FIRST + joint, "path": path}})
            samplers.append({"input": clock, "output": writer.add_accessor(looped), "interpolation": "LINEAR"})
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
        node: dict[str, object] = {"name": joint_name(joint), "translation": offset[joint].tolist()}
        writer.append("nodes", node | ({"children": below} if below else {}))


def _add_skin(writer: GlbWriter, rest: np.ndarray) -> None:
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(rest), 1, 1))
    inverse[:, 3, :3] = -rest  # column-major, as glTF has it
    matrices = writer.add_accessor(inverse.reshape(-1, 16))
    joints = list(range(_FIRST, _FIRST + len(rest)))
    writer.append("skins", {"inverseBindMatrices": matrices, "joints": joints, "skeleton": 1})


def relative_to_parents(
    parent: Int32[np.ndarray, " B"], rotation: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Each joint's rotation [T, B, 3, 3] and place [T, B, 3] as its parent sees it."""
    has, above = parent >= 0, np.maximum(parent, 0)
    outer = np.where(has[:, None, None], rotation[:, above], np.eye(3)).swapaxes(-1, -2)
    origin = np.where(has[:, None], place[:, above], 0)
    return outer @ rotation, np.einsum("tbij,tbj->tbi", outer, place - origin)


def steady(wxyz: np.ndarray) -> np.ndarray:
    """Quaternions x, y, z, w with the sign that is nearer to the previous frame."""
    xyzw = wxyz[:, [1, 2, 3, 0]]
    turns = (xyzw[1:] * xyzw[:-1]).sum(axis=1) < 0
    sign = np.where(np.cumsum(turns) % 2 == 1, -1.0, 1.0)
    xyzw[1:] *= sign[:, None]
    return np.asarray(xyzw / np.linalg.norm(xyzw, axis=1, keepdims=True))
