"""`tree.rig.safetensors`: bones, their turn modes, and weights of vertices and voxels. See docs/formats.md."""

from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field

from dynamictree.byte_stream import ByteReader, ByteWriter
from dynamictree.errors import FormatError
from dynamictree.formats.tensors.container import MAX_FRAMES, checked_tensor, facts_of, read_tensors, write_tensors
from dynamictree.rig.pose import Skeleton, Weights
from dynamictree.rig.rig import BONES_PER_VOXEL, Rig
from dynamictree.spectrum import quantise

FORMAT, VERSION = "tree-rig", "1"


class _Facts(BaseModel):
    num_frames: Annotated[int, Field(ge=1, le=MAX_FRAMES)]


def write_rig(rig: Rig, stream: ByteWriter) -> None:
    """Write a rig; `read_rig` restores rigs of `rig_of` exactly, as these are quantised like the file."""
    turns, steps = quantise(rig.turns)
    tensors = {
        "parent": rig.skeleton.parent,
        "foot_m": rig.skeleton.foot_m,
        "reach_m": rig.skeleton.reach_m,
        "in_surface": rig.skeleton.in_surface.astype(np.uint8),
        "turns": turns,
        "turn_step_rad": steps,
        "vertex_bone": rig.vertices.rows[:, 0],
        "vertex_parent_share": _bytes(rig.vertices.shares[:, 1]),
        "voxel_bones": rig.voxels.rows,
        "voxel_shares": _bytes(rig.voxels.shares),
    }
    write_tensors(stream, tensors, {"format": FORMAT, "version": VERSION, "num_frames": str(rig.num_frames)})


def read_rig(stream: ByteReader) -> Rig:
    """Read a rig.

    Raises:
        FormatError: the file is no rig of a known version, or its bones do not fit together.
    """
    tensors, metadata = read_tensors(stream, file_format=FORMAT, version=VERSION)
    parent = checked_tensor(tensors, "parent", dtypes=("int32",), shape=(None,))
    num_bones = len(parent)
    steps = checked_tensor(tensors, "turn_step_rad", dtypes=("float32",), shape=(None,))
    parts = checked_tensor(tensors, "turns", dtypes=("int16",), shape=(num_bones, len(steps), 3, 2))
    bone = checked_tensor(tensors, "vertex_bone", dtypes=("int32",), shape=(None,))
    of_parent = checked_tensor(tensors, "vertex_parent_share", dtypes=("uint8",), shape=(len(bone),)) / np.float32(255)
    voxel_bones = checked_tensor(tensors, "voxel_bones", dtypes=("int32",), shape=(None, BONES_PER_VOXEL))
    voxel_shares = checked_tensor(tensors, "voxel_shares", dtypes=("uint8",), shape=voxel_bones.shape)
    before = np.arange(num_bones)
    if num_bones == 0 or parent[0] != -1 or (parent[1:] < 0).any() or (parent >= before).any():
        raise FormatError("the rig's bones are not in order: the ground first, parents before children")
    for rows in (bone, voxel_bones):
        if len(rows) and not 0 <= rows.min() <= rows.max() < num_bones:
            raise FormatError(f"the rig names bone {rows.max()} of {num_bones}")
    turns = parts * steps[:, None, None]
    return Rig(
        skeleton=Skeleton(
            parent=parent,
            foot_m=checked_tensor(tensors, "foot_m", dtypes=("float32",), shape=(num_bones, 3)),
            reach_m=checked_tensor(tensors, "reach_m", dtypes=("float32",), shape=(num_bones, 3)),
            in_surface=checked_tensor(tensors, "in_surface", dtypes=("uint8",), shape=(num_bones,)) > 0,
        ),
        turns=(turns[..., 0] + 1j * turns[..., 1]).astype(np.complex64),
        vertices=Weights(
            rows=np.stack([bone, np.maximum(parent[bone], 0)], axis=1),
            shares=np.stack([1 - of_parent, of_parent], axis=1).astype(np.float32),
        ),
        voxels=Weights(rows=voxel_bones, shares=(voxel_shares / np.float32(255)).astype(np.float32)),
        num_frames=facts_of(metadata, _Facts).num_frames,
    )


def _bytes(shares: np.ndarray) -> np.ndarray:
    return np.asarray(np.rint(255 * shares), np.uint8)
