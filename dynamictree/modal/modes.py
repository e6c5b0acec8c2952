"""Export a spectrum's modes for programs that evaluate them: 16 bits per number, with the rig's bones.

Tensors of the file (safetensors): `coords` int16 [V, 3]; `shapes` int16 [V, K, 3, 2], φ = shapes · scale_m of the bin;
`scale_m` float32 [K]; `frequencies_hz` float32 [K]; of the rig's bones `bone_parent` int32 [B], -1 for the ground,
`bone_foot_m` and `bone_reach_m` float32 [B, 3], `bone_turns` int16 [B, K, 3, 2], θ = bone_turns · bone_scale_rad of the
bin, `bone_scale_rad` float32 [K]; of the joints that a pull bends `joint_parent` int32 [J], -1 for the ground,
`joint_place_m` float32 [J, 3], `joint_give` float32 [J]; `bone_of_voxel` int32 [V] and `joint_of_bone` int32 [B]. Index
k is the frequency bin; bin 0 is no mode and 0. If the spectrum is available, `lean_m` float32 [V, 3] is its bin 0: the
mean displacement of each voxel in the wind. docs/interaction.md describes their use.
"""

import json
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int16

from dynamictree.modal.system import ModalSystem
from dynamictree.spectrum import quantise

if TYPE_CHECKING:  # modules that import numba
    from dynamictree.modal.bones import Bones
    from dynamictree.modal.joints import Joints

FORMAT = "tree-modes"
VERSION = "2"


def mode_tensors(system: ModalSystem, bones: "Bones", joints: "Joints", *, shapes: bool) -> dict[str, np.ndarray]:
    """Return the tensors from which u(p) is computed, without coordinates and weights; `shapes` adds the large ones."""
    tensors: dict[str, np.ndarray] = {
        "coords": system.grid.coords.astype(np.int16),
        "frequencies_hz": np.concatenate([[0], system.wind_omega / (2 * np.pi)]).astype(np.float32),
        "bone_of_voxel": bones.of_voxel,
        "joint_parent": joints.parent,
        "joint_place_m": joints.place_m.astype(np.float32),
        "joint_give": joints.compliance.astype(np.float32),
        "joint_of_bone": joints.of_bone,
    }
    if not shapes:
        return tensors
    (steps, scale), (turns, scale_rad) = quantise(system.shapes), quantise(bones.shapes)
    return tensors | {
        "shapes": _from_bin_zero(steps),
        "scale_m": np.concatenate([[0], scale]).astype(np.float32),
        "bone_parent": bones.skeleton.parent,
        "bone_foot_m": bones.skeleton.foot_m,
        "bone_reach_m": bones.skeleton.reach_m,
        "bone_turns": _from_bin_zero(turns),
        "bone_scale_rad": np.concatenate([[0], scale_rad]).astype(np.float32),
    }


def mode_metadata(system: ModalSystem) -> dict[str, str]:
    """Return the file's metadata: format, version, and the grid's origin and voxel size."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "origin_m": json.dumps(list(system.grid.origin_m)),
        "voxel_size_m": json.dumps(system.grid.voxel_size_m),
        "up_axis": "+Z",
        "unit": "m",
    }


def _from_bin_zero(shapes: Int16[np.ndarray, "N M 3 2"]) -> Int16[np.ndarray, "N K 3 2"]:
    return np.pad(shapes, ((0, 0), (1, 0), (0, 0), (0, 0)))
