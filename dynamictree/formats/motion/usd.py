"""A motion as USD: a mesh with a time sample of its points per frame, its materials and textures, in one USDZ.

+Z up, metres, vertices in the source's order. Needs usd-core, the extra `usd`.
"""

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float32

from dynamictree.formats.gltf.writer import linear_colors
from dynamictree.mesh import Material, TriangleMesh

ROOT = "/Tree"


def write_motion_usdz(
    mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]], stream: BinaryIO, *, fps: float
) -> None:
    """Write displacements [m], a time code per frame, from 0."""
    from pxr import UsdGeom

    with packed_stage(stream, fps) as (stage, folder):
        set_root(stage, UsdGeom.Xform.Define(stage, ROOT))
        define_surface(stage, ROOT, mesh, folder)
        stage.SetEndTimeCode(set_points(stage, f"{ROOT}/Surface", mesh, frames))


@contextmanager
def packed_stage(stream: BinaryIO, fps: float) -> Iterator[tuple[Any, Path]]:
    """Yield an empty stage in metres and +Z up, with a time code per frame from 0, and the folder of its files.

    At the end all files of the folder are packed, the layer first, under their own names and with modification times in
    1980, so that equal input gives equal bytes.
    """
    no_time_s = 315_576_000  # 1 January 1980 at noon, the first day that ZIP can store
    from pxr import Sdf, Usd, UsdGeom

    with tempfile.TemporaryDirectory(prefix="dynamictree-usd-") as name:
        folder, layer = Path(name), Path(name) / "tree.usdc"
        stage = Usd.Stage.CreateNew(str(layer))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(0)
        yield stage, folder
        stage.Save()
        files = [layer, *sorted(set(folder.iterdir()) - {layer})]
        package = folder / "tree.usdz"
        archive = Sdf.ZipFileWriter.CreateNew(str(package))
        for path in files:
            os.utime(path, (no_time_s, no_time_s))
            archive.AddFile(str(path), path.name)
        archive.Save()
        with package.open("rb") as written:
            shutil.copyfileobj(written, stream)


def set_root(stage: Any, root: Any) -> None:
    """Make a prim the stage's default, which other files reference."""
    from pxr import Kind, Usd

    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)


def define_surface(stage: Any, root: str, mesh: TriangleMesh, folder: Path) -> None:
    """Define the mesh at rest as `Surface` below `root`, its materials as `Looks`; write textures into the folder."""
    _define_mesh(stage, root, mesh)
    for number, material in enumerate(mesh.look.materials):
        _define_material(stage, _looks(root, mesh, number), material, folder / f"texture_{number}.png")


def _looks(root: str, mesh: TriangleMesh, number: int) -> str:
    from pxr import Tf

    return f"{root}/Looks/{Tf.MakeValidIdentifier(mesh.look.materials[number].name or 'Material')}_{number}"


def _define_mesh(stage: Any, root: str, mesh: TriangleMesh) -> None:
    """Define the mesh at rest, with its faces bound to its materials."""
    from pxr import Sdf, UsdGeom, UsdShade, Vt

    surface = UsdGeom.Mesh.Define(stage, f"{root}/Surface")
    surface.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.vertices)))
    surface.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(mesh.num_faces, 3, np.int32)))
    surface.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(mesh.faces.ravel())))
    surface.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    surface.CreateDoubleSidedAttr(True)
    if mesh.look.uv is not None:
        upward = np.stack([mesh.look.uv[:, 0], 1 - mesh.look.uv[:, 1]], axis=1)  # USD's t points up, glTF's v down
        st = UsdGeom.PrimvarsAPI(surface).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(upward)))
    if mesh.look.vertex_colors is not None:
        colors = (linear_colors(mesh.look.vertex_colors)[:, :3] / 65535).astype(np.float32)
        surface.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(
            Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(colors))
        )
    if not mesh.look.materials:
        return
    binding = UsdShade.MaterialBindingAPI.Apply(surface.GetPrim())
    binding.Bind(UsdShade.Material.Define(stage, _looks(root, mesh, 0)))
    for number in np.unique(mesh.material_of_face).tolist():
        chosen = np.flatnonzero(mesh.material_of_face == number).astype(np.int32)
        part = binding.CreateMaterialBindSubset(f"Part_{number}", Vt.IntArray.FromNumpy(chosen))
        looks = UsdShade.Material.Define(stage, _looks(root, mesh, number))
        UsdShade.MaterialBindingAPI.Apply(part.GetPrim()).Bind(looks)


def set_points(stage: Any, path: str, mesh: TriangleMesh, frames: Iterable[Float32[np.ndarray, "N 3"]]) -> int:
    """Write every frame of a surface and return the last time code."""
    from pxr import Gf, UsdGeom, Vt

    surface = UsdGeom.Mesh.Get(stage, path)
    points, extent = surface.CreatePointsAttr(), surface.CreateExtentAttr()
    frame = 0
    for frame, displacement in enumerate(frames):
        moved = mesh.vertices + displacement
        low, high = moved.min(axis=0).tolist(), moved.max(axis=0).tolist()
        points.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(moved)), frame)
        extent.Set(Vt.Vec3fArray([Gf.Vec3f(*low), Gf.Vec3f(*high)]), frame)
    return frame


def _define_material(stage: Any, path: str, material: Material, texture: Path) -> None:
    """Define glTF's base colour as a UsdPreviewSurface; write its texture."""
    from pxr import Gf, Sdf, UsdShade

    looks = UsdShade.Material.Define(stage, path)
    preview = UsdShade.Shader.Define(stage, f"{path}/Preview")
    preview.CreateIdAttr("UsdPreviewSurface")
    preview.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    preview.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    diffuse = preview.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.Set(Gf.Vec3f(*material.base_color[:3]))
    if material.texture_png is not None:
        texture.write_bytes(material.texture_png)
        reader = UsdShade.Shader.Define(stage, f"{path}/Coordinates")
        reader.CreateIdAttr("UsdPrimvarReader_float2")
        reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
        image = UsdShade.Shader.Define(stage, f"{path}/Texture")
        image.CreateIdAttr("UsdUVTexture")
        image.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(texture.name))
        image.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
        image.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*material.base_color))
        for side in ("wrapS", "wrapT"):
            image.CreateInput(side, Sdf.ValueTypeNames.Token).Set("repeat")
        image.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
            reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
        )
        diffuse.ConnectToSource(image.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))
        if material.alpha_cutoff is not None:
            opacity = preview.CreateInput("opacity", Sdf.ValueTypeNames.Float)
            opacity.ConnectToSource(image.CreateOutput("a", Sdf.ValueTypeNames.Float))
            preview.CreateInput("opacityThreshold", Sdf.ValueTypeNames.Float).Set(material.alpha_cutoff)
    looks.CreateSurfaceOutput().ConnectToSource(preview.CreateOutput("surface", Sdf.ValueTypeNames.Token))
