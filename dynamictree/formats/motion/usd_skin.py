"""A motion as USD with a skeleton (`UsdSkel`): the joints and weights of the skinned GLB, in a USDZ package.

+Z up, metres, vertices in the source's order. Needs usd-core, the extra `usd`.
"""

from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float32

from dynamictree.formats.gltf.skin import joint_name
from dynamictree.formats.motion.usd import ROOT, define_surface, packed_stage, set_root
from dynamictree.mesh import TriangleMesh
from dynamictree.skin import JOINTS_PER_VERTEX, Skin

_SKELETON, _SWAY = f"{ROOT}/Skeleton", f"{ROOT}/Skeleton/Sway"


def write_skinned_usdz(mesh: TriangleMesh, skin: Skin, stream: BinaryIO, *, fps: float) -> None:
    """Write one period with a time code per frame; the last of T + 1 repeats the first frame."""
    from pxr import UsdSkel

    with packed_stage(stream, fps) as (stage, folder):
        set_root(stage, UsdSkel.Root.Define(stage, ROOT))
        define_surface(stage, ROOT, mesh, folder)
        joints = list[str]()  # paths: each joint's name below those of its parents, which come before it
        for joint, parent in enumerate(skin.parent.tolist()):
            joints.append(f"{joints[parent]}/{joint_name(joint)}" if parent >= 0 else joint_name(joint))
        _define_skeleton(stage, skin, joints)
        _define_sway(stage, skin, joints)
        _bind(stage, skin)
        stage.SetEndTimeCode(len(skin.turns))


def _define_skeleton(stage: Any, skin: Skin, joints: list[str]) -> None:
    from pxr import Gf, UsdSkel, Vt

    skeleton = UsdSkel.Skeleton.Define(stage, _SKELETON)
    skeleton.CreateJointsAttr(joints)
    places = {"bind": skin.joint_m, "rest": _offsets(skin)}
    bind, rest = ([Gf.Matrix4d(1).SetTranslate(Gf.Vec3d(*place)) for place in places[name].tolist()] for name in places)
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray(bind))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray(rest))
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([_SWAY])


def _define_sway(stage: Any, skin: Skin, joints: list[str]) -> None:
    from pxr import UsdSkel, Vt

    sway = UsdSkel.Animation.Define(stage, _SWAY)
    sway.CreateJointsAttr(joints)
    sway.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(np.ones((len(joints), 3), np.float16)))
    wxyz = skin.turns / np.linalg.norm(skin.turns, axis=2, keepdims=True)
    xyzw = np.ascontiguousarray(wxyz[:, :, [1, 2, 3, 0]])
    sway.CreateTranslationsAttr(Vt.Vec3fArray.FromNumpy(_offsets(skin)))
    rotations = sway.CreateRotationsAttr()
    for code in range(len(xyzw) + 1):
        rotations.Set(Vt.QuatfArray.FromNumpy(xyzw[code % len(xyzw)]), code)


def _offsets(skin: Skin) -> Float32[np.ndarray, "B 3"]:
    """Return the joints' rest positions relative to their parents [m]."""
    return np.asarray(skin.joint_m - np.where(skin.parent[:, None] >= 0, skin.joint_m[skin.parent], 0))


def _bind(stage: Any, skin: Skin) -> None:
    from pxr import UsdSkel, Vt

    binding = UsdSkel.BindingAPI.Apply(stage.GetPrimAtPath(f"{ROOT}/Surface"))
    used = skin.weights > 0
    rows, weights = np.where(used, skin.rows, 0).ravel(), np.where(used, skin.weights, 0).ravel()
    binding.CreateJointIndicesPrimvar(False, JOINTS_PER_VERTEX).Set(Vt.IntArray.FromNumpy(rows.astype(np.int32)))
    binding.CreateJointWeightsPrimvar(False, JOINTS_PER_VERTEX).Set(Vt.FloatArray.FromNumpy(weights.astype(np.float32)))
    binding.CreateSkeletonRel().SetTargets([_SKELETON])
