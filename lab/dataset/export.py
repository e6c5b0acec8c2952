"""One tree of the dataset as files that other programs open: GLB, PLY sequence, USD."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.motion.ply_sequence import iter_ply_sequence_zip
from dynamictree.spectrum import FPS, NUM_FRAMES, iter_motion
from lab.dataset.sample import Sample


def export_sample(sample: Sample, name: str, folder: Path) -> Path:
    """Write a tree in one of the `EXPORTS`, and give the file's path."""
    ending, write = EXPORTS[name]
    path = folder / f"4dtree-{sample.seed:07d}{ending}"
    unfinished = path.with_name(f".{path.name}")
    write(sample, unfinished)
    unfinished.replace(path)
    return path


def _write_glb(sample: Sample, path: Path) -> None:
    with path.open("wb") as stream:
        write_motion_glb(sample.mesh, sample.coefficients, stream)


def _write_ply(sample: Sample, path: Path) -> None:
    phases = np.arange(NUM_FRAMES) / NUM_FRAMES
    with path.open("wb") as stream:
        for piece in iter_ply_sequence_zip(sample.mesh, iter_motion(sample.coefficients, phases)):
            stream.write(piece)


def _write_usd(sample: Sample, path: Path) -> None:
    """A mesh whose points have a time sample a frame."""
    from pxr import Gf, Usd, UsdGeom, Vt

    mesh = sample.mesh
    stage = Usd.Stage.CreateInMemory(".usdc")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(FPS)
    stage.SetFramesPerSecond(FPS)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(NUM_FRAMES - 1)
    root = UsdGeom.Xform.Define(stage, "/Tree")
    stage.SetDefaultPrim(root.GetPrim())
    prim = UsdGeom.Mesh.Define(stage, "/Tree/Surface")
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(mesh.num_faces, 3, np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(mesh.faces.ravel())))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    prim.CreateDoubleSidedAttr(True)
    points, extent = prim.CreatePointsAttr(), prim.CreateExtentAttr()
    for frame, displacement in enumerate(iter_motion(sample.coefficients, np.arange(NUM_FRAMES) / NUM_FRAMES)):
        moved = mesh.vertices + displacement
        low, high = moved.min(axis=0).tolist(), moved.max(axis=0).tolist()
        points.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(moved)), frame)
        extent.Set(Vt.Vec3fArray([Gf.Vec3f(*low), Gf.Vec3f(*high)]), frame)
    colors = np.array([material.base_color[:3] for material in mesh.look.materials], np.float32)
    if mesh.look.face_material is not None:
        prim.CreateDisplayColorPrimvar(UsdGeom.Tokens.uniform).Set(
            Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(colors[mesh.look.face_material]))
        )
    prim.GetPrim().SetCustomDataByKey("species", sample.species)
    prim.GetPrim().SetCustomDataByKey("windSpeed", sample.wind.speed_m_s)
    stage.GetRootLayer().Export(str(path))


EXPORTS: dict[str, tuple[str, Callable[[Sample, Path], None]]] = {
    "glb": (".glb", _write_glb),
    "ply": (".ply.zip", _write_ply),
    "usd": (".usdc", _write_usd),
}
"""File ending and writer of each format."""
