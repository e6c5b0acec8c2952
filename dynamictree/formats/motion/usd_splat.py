"""A moving splat as USD: a `ParticleField3DGaussianSplat` with time samples, in a USDZ package.

+Z up, metres. Colours are those at rest: harmonics do not turn with the Gaussians. Needs usd-core, the extra `usd`.
"""

from collections.abc import Iterable
from typing import BinaryIO

import numpy as np

from dynamictree.formats.motion.usd import ROOT, packed_stage
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.deform import Pose


def write_splat_usdz(cloud: GaussianCloud, poses: Iterable[Pose], stream: BinaryIO, *, fps: float) -> None:
    """Write a time code per pose of a cloud, from 0."""
    from pxr import UsdGeom, UsdVol, Vt

    with packed_stage(stream, fps) as (stage, _):
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, ROOT).GetPrim())
        splat = UsdVol.ParticleField3DGaussianSplat.Define(stage, f"{ROOT}/Splat")
        splat.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(cloud.opacity))
        splat.CreateRadianceSphericalHarmonicsDegreeAttr(cloud.sh_degree)
        harmonics = np.ascontiguousarray(cloud.sh.reshape(-1, 3))
        splat.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(harmonics))
        positions, extent = splat.CreatePositionsAttr(), splat.CreateExtentAttr()
        orientations, scales = splat.CreateOrientationshAttr(), splat.CreateScaleshAttr()
        frame = 0
        for frame, pose in enumerate(poses):
            xyzw = np.ascontiguousarray(pose.quaternions[:, [1, 2, 3, 0]], np.float16)  # as Gf stores a quaternion
            positions.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(pose.means)), frame)
            orientations.Set(Vt.QuathArray.FromNumpy(xyzw), frame)
            scales.Set(Vt.Vec3hArray.FromNumpy(np.ascontiguousarray(pose.scales, np.float16)), frame)
            reach = 3 * pose.scales.max(axis=1, keepdims=True)
            bounds = np.stack([(pose.means - reach).min(axis=0), (pose.means + reach).max(axis=0)])
            extent.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(bounds, np.float32)), frame)
        stage.SetEndTimeCode(frame)
