"""A spectrum's modes for a program that evaluates them itself: 16 bits a number, with the bones of the warp.

Tensors of the file (safetensors): `coords` int16 [V, 3]; `shapes` int16 [V, K, 3, 2], φ = shapes · scale_m of the bin;
`scale_m` float32 [K]; `frequencies_hz` float32 [K]; `bone_of_voxel` int32 [V]; and of the bones `bone_parent` int32
[B], `bone_joint_m` and `bone_reach_m` float32 [B, 3], `bone_lever_m2` float32 [B], `bone_shapes` int16 [B, K, 3, 2].
Index k is the frequency bin; bin 0 is no mode and 0. Where the spectrum is at hand, `lean_m` float32 [V, 3] is its bin
0: how far the mean wind leans each voxel. docs/interaction.md tells how they are used.
"""

import json

import numpy as np
from jaxtyping import Complex64, Float32, Int16

from dynamictree.modal.bones import Bones
from dynamictree.modal.system import ModalSystem

FORMAT = "tree-modes"
VERSION = "1"
_LARGEST = 32767


def mode_tensors(system: ModalSystem, bones: Bones) -> dict[str, np.ndarray]:
    """Everything that u(p) needs but the coordinates and the weights."""
    shapes, scale = quantised(system.shapes)
    return {
        "coords": system.grid.coords.astype(np.int16),
        "shapes": _from_bin_zero(shapes),
        "scale_m": np.concatenate([[0], scale]).astype(np.float32),
        "frequencies_hz": np.concatenate([[0], system.wind_omega / (2 * np.pi)]).astype(np.float32),
        "bone_of_voxel": bones.bone_of_voxel,
        "bone_parent": bones.parent,
        "bone_joint_m": bones.joint_m,
        "bone_reach_m": bones.reach_m,
        "bone_lever_m2": bones.lever_m2,
        "bone_shapes": _from_bin_zero(_in_steps(bones.shapes, scale)),
    }


def mode_metadata(system: ModalSystem) -> dict[str, str]:
    """The file's strings: format, version, and where voxels lie."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "origin_m": json.dumps(list(system.grid.origin_m)),
        "voxel_size_m": json.dumps(system.grid.voxel_size_m),
        "up_axis": "+Z",
        "unit": "m",
    }


def quantised(
    shapes: Complex64[np.ndarray, "N M 3"],
) -> tuple[Int16[np.ndarray, "N M 3 2"], Float32[np.ndarray, " M"]]:
    """Shapes in 16 bits, and the metres of a step of each mode."""
    scale = np.maximum(np.abs(_parts(shapes)).max(axis=(0, 2, 3)) / _LARGEST, np.finfo(np.float32).tiny)  # [M]
    return _in_steps(shapes, scale), scale


def _in_steps(shapes: Complex64[np.ndarray, "N M 3"], scale: Float32[np.ndarray, " M"]) -> Int16[np.ndarray, "N M 3 2"]:
    steps = np.rint(_parts(shapes) / scale[:, None, None])
    limited: Int16[np.ndarray, "N M 3 2"] = np.clip(steps, -_LARGEST, _LARGEST).astype(np.int16)
    return limited


def _from_bin_zero(shapes: Int16[np.ndarray, "N M 3 2"]) -> Int16[np.ndarray, "N K 3 2"]:
    return np.pad(shapes, ((0, 0), (1, 0), (0, 0), (0, 0)))


def _parts(shapes: Complex64[np.ndarray, "N M 3"]) -> Float32[np.ndarray, "N M 3 2"]:
    return np.stack([shapes.real, shapes.imag], axis=-1)
