"""Write a forest as USD: a `PointInstancer` of a few trees with different phases, each with one time sample per frame.

+Z up, metres. Needs usd-core, the extra `usd`.
"""

from collections.abc import Sequence
from typing import BinaryIO

import numpy as np
from jaxtyping import Complex64

from dynamictree.errors import InputError
from dynamictree.formats.motion.usd import define_surface, packed_stage, set_points
from dynamictree.gaussian.cloud import MAX_SEQUENCE_BYTES
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import iter_motion
from recipes.forest_glb import StandingTree, group_by_motion

_FOREST = "/Forest"
_MOTIONS = f"{_FOREST}/Motions"


def write_forest_usdz(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    trees: Sequence[StandingTree],
    stream: BinaryIO,
    *,
    num_frames: int,
    fps: float,
    num_motions: int,
    wind_deg: float = 0.0,
) -> None:
    """Write one period, one time code per frame from 0; trees that are neighbours along the wind share a motion.

    Raises:
        InputError: there is less than one motion, or more than trees, or the file would be too large.
    """
    from pxr import Sdf, UsdGeom, Vt

    groups = group_by_motion(trees, num_motions, wind_deg)
    size = 12 * mesh.num_vertices * num_frames * num_motions
    if size > MAX_SEQUENCE_BYTES:
        raise InputError(f"{num_motions} motions are {size / 1e9:.1f} GB as USD: ask for fewer motions")
    foot = np.array([*mesh.vertices[:, :2].mean(axis=0), mesh.vertices[:, 2].min()], np.float32)
    standing = mesh.with_vertices(mesh.vertices - foot)
    with packed_stage(stream, fps) as (stage, folder):
        forest = UsdGeom.PointInstancer.Define(stage, _FOREST)
        stage.SetDefaultPrim(forest.GetPrim())
        stage.DefinePrim(_MOTIONS, "Scope")
        phases = np.arange(num_frames) / num_frames
        for number, group in enumerate(groups):
            path = f"{_MOTIONS}/motion_{number}"
            prim = UsdGeom.Xform.Define(stage, path).GetPrim()
            if number == 0:
                define_surface(stage, path, standing, folder)
            else:
                prim.GetReferences().AddInternalReference(f"{_MOTIONS}/motion_0")
            turn = np.exp(1j * group[len(group) // 2].phase_rad).astype(np.complex64)
            own = coefficients * turn[None, :, None]
            set_points(stage, f"{path}/Surface", standing, iter_motion(own, phases, num_frames))
        every = [(tree, number) for number, group in enumerate(groups) for tree in group]
        forest.CreatePrototypesRel().SetTargets([Sdf.Path(f"{_MOTIONS}/motion_{n}") for n in range(len(groups))])
        forest.CreateProtoIndicesAttr(Vt.IntArray([number for _, number in every]))
        forest.CreatePositionsAttr(Vt.Vec3fArray([tree.position_m for tree, _ in every]))
        forest.CreateScalesAttr(Vt.Vec3fArray([(tree.scale,) * 3 for tree, _ in every]))
        stage.SetEndTimeCode(num_frames - 1)
