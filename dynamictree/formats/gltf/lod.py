"""Levels of detail of one motion as a GLB: a node per level below MSFT_lod, all driven by the same keys."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Complex64

from dynamictree.byte_stream import ByteWriter
from dynamictree.formats.gltf.motion import clipped_targets, clipped_weights, loop_parts, loop_weights
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.up_axis import up_rotation

EXTENSION = "MSFT_lod"


def write_lod_glb(
    levels: Sequence[tuple[TriangleMesh, Complex64[np.ndarray, "_ K 3"]]],
    stream: ByteWriter,
    *,
    coverage: Sequence[float],
    num_frames: int,
    fps: float,
    extras: Mapping[str, object],
) -> None:
    """Write one period, keys as in `write_motion_glb`; the finest level first.

    `coverage` is the share of the screen's height down to which each level is shown. Levels with the same materials
    share them. A reader without MSFT_lod shows the finest level.
    """
    writer = GlbWriter(root={"extensionsUsed": [EXTENSION]}, extras=dict(extras))
    rotation = up_rotation("+Y").astype(np.float32)
    materials: dict[int, Sequence[int]] = {}
    for number, (mesh, coefficients) in enumerate(levels):
        targets = [
            {"POSITION": writer.add_accessor(target.reshape(-1, 3) @ rotation, target=VERTEX_BUFFER, bounds=True)}
            for target in clipped_targets(loop_parts(coefficients, num_frames))
        ]
        key = id(mesh.look.materials)
        materials[key] = add_mesh(writer, mesh, targets=targets, materials=materials.get(key))
        node: dict[str, object] = {"mesh": number, "name": f"tree_lod{number}"}
        if number == 0:
            node["extensions"] = {EXTENSION: {"ids": list(range(1, len(levels)))}}
            node["extras"] = {"MSFT_screencoverage": list(coverage)}
        writer.append("nodes", node)
    weights = clipped_weights(loop_weights(levels[0][1].shape[1], num_frames))
    keys = np.concatenate([weights, weights[:1]]).astype(np.float32).reshape(-1, 1)
    times = (np.arange(num_frames + 1) / fps).astype(np.float32)
    sampler = {
        "input": writer.add_accessor(times[:, None], bounds=True),
        "output": writer.add_accessor(keys),
        "interpolation": "LINEAR",
    }
    channels = [{"sampler": 0, "target": {"node": number, "path": "weights"}} for number in range(len(levels))]
    writer.append("animations", {"name": "sway", "samplers": [sampler], "channels": channels})
    writer.append("scenes", {"nodes": [0]})
    writer.finish(stream)
