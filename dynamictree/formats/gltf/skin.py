"""A motion as a GLB with a skeleton: joints that turn, four per vertex, with keys of one period in 16 bits.

It is the cheapest to play in engines. The file's `asset.extras` state its error against the motion.
"""

from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int32

from dynamictree.byte_stream import ByteWriter
from dynamictree.formats.gltf.meshopt import compress
from dynamictree.formats.gltf.template import (
    add_mesh_joints,
    attach_joints,
    can_carry_joints,
    open_document,
    plain_document,
)
from dynamictree.formats.gltf.writer import GlbWriter
from dynamictree.mesh import TriangleMesh
from dynamictree.skin import Skin, SkinSummary
from dynamictree.up_axis import up_rotation


class Packing(NamedTuple):
    """Packing of a file: compression by meshoptimizer, and WebP textures where these are smaller."""

    compressed: bool
    as_webp: bool


def write_skinned_glb(
    mesh: TriangleMesh, skin: Skin, summary: SkinSummary, stream: ByteWriter, *, fps: float, packing: Packing
) -> SkinSummary:
    """Write one period with linear keys, the last equal to the first; return the errors, packing included.

    A mesh that was read from glTF stays in its document, unless that cannot carry joints or the file is to be packed.
    """
    document = None if any(packing) or mesh.gltf is None or not can_carry_joints(mesh.gltf) else mesh.gltf
    writer = plain_document(mesh, as_webp=packing.as_webp) if document is None else open_document(mesh)
    source, rest = mesh.source, _rest(skin)
    if document is not None:  # the document has an origin of its own
        rest = rest + source.scale * up_rotation(source.up_axis) @ np.array(source.offset) @ up_rotation("+Y")
    skeleton, first = _add_joints(writer, skin.parent, rest)
    if document is not None:
        nodes = attach_joints(writer, document, skin, lambda placed: _add_skin(writer, rest, first, placed))
        scene = writer.root["scenes"][writer.root.get("scene", 0)]
        scene["nodes"] = [*scene["nodes"], *nodes, skeleton]
    else:
        attributes = add_mesh_joints(writer, skin)
        for primitive in writer.root["meshes"][0]["primitives"]:
            primitive["attributes"] |= attributes
        writer.root["nodes"][0]["skin"] = _add_skin(writer, rest, first, np.eye(4))
        writer.append("scenes", {"nodes": [0, skeleton]})
    _add_sway(writer, skin, fps, first)
    if packing.compressed:
        summary = _with_rest_error(summary, np.linalg.norm(compress(writer).astype(np.float64), axis=1))
    writer.extras = asdict(summary) | source.extras
    writer.finish(stream)
    return summary


def _with_rest_error(summary: SkinSummary, change_m: Float64[np.ndarray, " N"]) -> SkinSummary:
    """Add the error of the mesh at rest, which moves with the joints, to a summary; the largest is an upper bound."""
    rms_m = float(np.hypot(summary.rms_error_m, np.sqrt((change_m**2).mean())))
    return replace(
        summary,
        relative_error=summary.relative_error * rms_m / summary.rms_error_m if summary.rms_error_m else 0.0,
        rms_error_m=rms_m,
        max_error_m=summary.max_error_m + float(change_m.max()),
    )


def joint_name(joint: int) -> str:
    """Return the name of a joint's node."""
    return f"joint_{joint}"


def _rest(skin: Skin) -> np.ndarray:
    """Return the joints' rest positions in the file's axes."""
    return np.asarray(skin.joint_m.astype(np.float64) @ up_rotation("+Y"))


def _add_sway(writer: GlbWriter, skin: Skin, fps: float, first: int) -> None:
    w, x, y, z = np.moveaxis(skin.turns, 2, 0)
    turns = np.rint(32767 * np.stack([x, z, -y, w], axis=2)).astype(np.int16)  # xyzw in the file's axes
    looped = np.concatenate([turns, turns[:1]])
    clock = writer.add_accessor((np.arange(len(looped)) / fps).astype(np.float32)[:, None], bounds=True)
    moving = np.flatnonzero(turns[:, :, :3].any(axis=(0, 2))).tolist()  # the others do not turn against their parents
    view = writer.add_view(np.ascontiguousarray(looped[:, moving].swapaxes(0, 1)).tobytes())
    keys = {"bufferView": view, "componentType": 5122, "normalized": True, "count": len(looped), "type": "VEC4"}
    samplers, channels = list[object](), list[object]()
    for number, joint in enumerate(moving):
        output = writer.append("accessors", keys | {"byteOffset": 8 * len(looped) * number})
        samplers.append({"input": clock, "output": output})
        channels.append({"sampler": number, "target": {"node": first + joint, "path": "rotation"}})
    others = writer.root.get("animations", [])
    writer.root["animations"] = [{"name": "sway", "samplers": samplers, "channels": channels}, *others]


def _add_joints(writer: GlbWriter, parent: Int32[np.ndarray, " B"], rest: np.ndarray) -> tuple[int, int]:
    """Add a node per joint, below one for the skeleton; return the indices of that one and of joint 0."""
    first = len(writer.root.get("nodes", [])) + 1
    children: list[list[int]] = [[] for _ in parent]
    for joint, above in enumerate(parent.tolist()):
        if above >= 0:
            children[above].append(first + joint)
    roots = [first + joint for joint in np.flatnonzero(parent < 0).tolist()]
    skeleton = writer.append("nodes", {"name": "skeleton", "children": roots})
    offset = rest - np.where(parent[:, None] >= 0, rest[parent], 0)
    for joint, below in enumerate(children):
        node: dict[str, object] = {"name": joint_name(joint), "translation": offset[joint].round(7).tolist()}
        writer.append("nodes", node | ({"children": below} if below else {}))
    return skeleton, first


def _add_skin(writer: GlbWriter, rest: np.ndarray, first: int, placed: Float64[np.ndarray, "4 4"]) -> int:
    """Add a skin for meshes that a matrix places at rest; return its index."""
    inverse = np.tile(placed, (len(rest), 1, 1))
    inverse[:, :3, 3] -= rest
    columns = inverse.swapaxes(1, 2).reshape(-1, 16)  # column-major
    matrices = writer.add_accessor(columns.astype(np.float32))
    joints = list(range(first, first + len(rest)))
    return writer.append("skins", {"inverseBindMatrices": matrices, "joints": joints, "skeleton": first - 1})
