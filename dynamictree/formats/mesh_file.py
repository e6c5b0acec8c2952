"""Mesh readers by format, and detection of a format from a file's first bytes."""

import io
import re
from collections.abc import Mapping
from dataclasses import replace

from dynamictree.byte_stream import ByteReader, read_all
from dynamictree.errors import FormatError
from dynamictree.formats.gltf.reader import read_gltf
from dynamictree.formats.mesh.foreign import read_foreign_mesh
from dynamictree.formats.mesh.obj import read_obj
from dynamictree.formats.mesh.ply import read_ply_mesh
from dynamictree.formats.mesh.stl import is_ascii_stl, read_stl
from dynamictree.formats.ply_table import read_header
from dynamictree.mesh import TriangleMesh, validate_mesh
from dynamictree.plant.axes_unit import Conventions
from dynamictree.plant.find import plant_of_mesh
from dynamictree.requests import Reading

MESH_TYPES = ("obj", "ply", "glb", "gltf", "stl", "off", "3mf", "dae")
MAX_FILE_BYTES = 1 << 30
ACCEPTED = (
    "a triangle mesh as OBJ, PLY with faces, STL, OFF, 3MF, COLLADA, glTF or GLB is accepted, a splat as PLY, .splat, "
    "SPZ, SOG, .ksplat or GLB, a scan as LAS, LAZ, PLY, PCD, XYZ, TXT, CSV, ASC or PTS, photos as JPEG, PNG, TIFF, "
    "WebP or HEIC, and a film as MP4, MOV or M4V"
)

_HABITS = {"obj": "+Y", "ply": "+Z", "stl": "+Z", "off": "+Z"}
"""Usual up axis of the formats that do not state one."""
_NOT_MESHES = {
    "las": "a laser scan (LAS or LAZ)",
    "pcd": "a laser scan (PCD)",
    "points": "a point cloud as text",
    "splat": "a Gaussian splat",
    "spz": "a Gaussian splat (SPZ)",
    "zip": "a ZIP archive: unpack it and give the folder or the model in it",
    "png": "a PNG image",
    "jpeg": "a JPEG image",
    "safetensors": "a safetensors file",
}
_MAGIC = (
    (b"glTF", "glb"),
    (b"LASF", "las"),
    (b"# .PCD", "pcd"),
    (b"PK\x03\x04", "zip"),
    (b"\x89PNG\r\n\x1a\n", "png"),
    (b"\xff\xd8\xff", "jpeg"),
)
_3MF_ENTRY = b"3D/3dmodel.model"
_OBJ_LINE = re.compile(rb"^[ \t]*(v|vt|vn|f|o|g|s|usemtl|mtllib)[ \t]+\S", re.MULTILINE)
_PLY_START = re.compile(rb"(\xef\xbb\xbf)?ply[ \t]*[\r\n]")  # some writers leave blanks at the end
_POINT_LINE = re.compile(rb"^[ \t]*[-+0-9.eE\"]+([ \t,;|]+[-+0-9.eE\"]+){2,}[ \t]*\r?$", re.MULTILINE)
_BLENDER = "open it in Blender and choose File, Export, glTF 2.0"
_SCAN = "save it as LAZ, PLY or XYZ, for instance with CloudCompare"
_ASSIMP = "convert it to glTF, for instance with Assimp: `assimp export tree.ac tree.glb`"
_TILE = "it is a tile of a map (3D Tiles); take the glTF out of it with `npx 3d-tiles-tools i3dmToGlb` or `b3dmToGlb`"
_CAD = "export it as STL, OBJ or glTF from the program that made it"
_UNPACK = "unpack it and give the folder or the file in it"
_BY_ENDING = {
    **dict.fromkeys(("fbx", "blend", "3ds", "abc", "x3d", "wrl", "usd", "usda", "usdc", "usdz"), _BLENDER),
    **dict.fromkeys(
        ("max", "ma", "mb", "c4d", "skp", "spm", "st", "st9"), "export it as glTF from the program it is of"
    ),
    **dict.fromkeys(("ac", "lwo", "b3d", "ms3d", "md2", "md3", "ase"), _ASSIMP),
    **dict.fromkeys(("i3dm", "b3dm", "cmpt"), _TILE),
    "pnts": "it is a tile of a point cloud (3D Tiles); give the LAS or LAZ file that it was made from",
    **dict.fromkeys(("dxf", "dwg", "step", "stp", "iges", "igs"), _CAD),
    **dict.fromkeys(("e57", "ptx", "rcp", "rcs", "fls", "zfs"), _SCAN),
    **dict.fromkeys(("rar", "7z", "tar", "tgz", "gz", "bz2", "xz"), _UNPACK),
    **dict.fromkeys(("heic", "heif"), "8 or more photos of a walk around the tree are for `dynamictree reconstruct`"),
    "avif": "save the photos as JPEG",
    **dict.fromkeys(("mp4", "mov", "m4v"), "a film of a walk around the tree is for `dynamictree reconstruct`"),
    **dict.fromkeys(
        ("avi", "mkv", "webm"),
        "a film of a walk around the tree is for `dynamictree reconstruct`; to upload it, export it as MP4",
    ),
    **dict.fromkeys(("lcc", "lci"), "convert it with `splat-transform scene.lcc scene.ply`"),
    "mtl": "these are the materials of an OBJ, which lie beside it: give the OBJ",
    "bin": "this is the buffer of a glTF, which lies beside it: give the .gltf",
}
_BY_BYTES = (
    (b"Kaydara FBX Binary", "FBX", _BLENDER),
    (b"; FBX ", "FBX", _BLENDER),
    (b"BLENDER", "Blender", _BLENDER),
    (b"xof 0", "DirectX", _ASSIMP),
    (b"AC3D", "AC3D", _ASSIMP),
    (b"PXR-USDC", "USD", _BLENDER),
    (b"#usda", "USD", _BLENDER),
    (b"Ogawa", "Alembic", _BLENDER),
    (b"ASTM-E57", "E57", _SCAN),
    (b"ISO-10303-21", "STEP", _CAD),
    (b"Rar!", "RAR", _UNPACK),
    (b"7z\xbc\xaf\x27\x1c", "7-Zip", _UNPACK),
    (b"\x1f\x8b", "gzip", _UNPACK),
    (b"version https://git-lfs", "Git LFS", "this is a pointer in place of the file: run `git lfs pull`"),
    (b"<!doctype html", "HTML", "this is a web page in place of the file: download it again"),
    (b"<html", "HTML", "this is a web page in place of the file: download it again"),
)


def read_mesh(
    stream: ByteReader, *, file_type: str, reading: Reading | None = None, companions: Mapping[str, bytes] | None = None
) -> TriangleMesh:
    """Read a mesh that the method can work on, in metres and +Z up.

    Args:
        stream: the file's bytes.
        file_type: one of `MESH_TYPES`, as `sniff_file_type` returns it.
        reading: the file's axis and unit; unset fields come from glTF or a PLY comment, or are detected
            (see `plant/axes_unit.py`).
        companions: content of the files that the mesh may name (MTL, textures, buffers), by the names it uses.

    Raises:
        InputError: the file cannot be read, is no mesh, or is one that the method cannot work on.
    """
    gltf_up_axis, gltf_unit_m = "+Y", 1.0  # glTF 2.0 specification, 3.4
    if file_type not in MESH_TYPES:
        what = _NOT_MESHES.get(file_type, f"of type {file_type[:20]!r}")
        raise FormatError(f"the file is {what}; {ACCEPTED}")
    content = read_all(stream, MAX_FILE_BYTES)
    reading = reading or Reading()
    beside = companions or {}
    file = Conventions(usual_up_axis=_HABITS.get(file_type))
    if file_type in ("glb", "gltf"):
        mesh = read_gltf(content, companions=beside)
        file = Conventions(up_axis=gltf_up_axis, unit_m=gltf_unit_m)
    elif file_type == "obj":
        mesh = read_obj(content, companions=beside)
    elif file_type == "ply":
        mesh = read_ply_mesh(content, companions=beside)
        header = read_header(io.BytesIO(content))
        file = replace(file, up_axis=header.up_axis, unit_m=header.unit_m)
    elif file_type == "stl":
        mesh = read_stl(content)
        file = replace(file, usual_units_m=(1.0, 0.001))
    else:
        foreign = read_foreign_mesh(content, file_type=file_type, companions=beside)
        mesh, file = foreign.mesh, replace(file, up_axis=foreign.up_axis, unit_m=foreign.unit_m)
    return plant_of_mesh(validate_mesh(mesh), reading, file)


def sniff_file_type(head: bytes, filename: str = "") -> str:
    """Recognise a file's type by its first kilobyte or more; the file name decides only if the bytes do not.

    Returns one of `MESH_TYPES`, or `las`, `pcd`, `points`, `splat`, `spz`, `zip`, `png`, `jpeg`, `safetensors`.

    Raises:
        FormatError: it is none of these.
    """
    ending = filename.rpartition(".")[2].lower()
    if head.startswith(b"PK\x03\x04") and (ending == "3mf" or _3MF_ENTRY in head):
        return "3mf"
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            if kind == "zip" and (advice := advice_for(head, ending)) is not None:  # USDZ
                raise FormatError(f"{advice}; {ACCEPTED}")
            return kind
    if _PLY_START.match(head):
        return "ply"
    if head[:2] == b"\x1f\x8b" and ending == "spz":
        return "spz"
    if head[8:9] == b"{" and int.from_bytes(head[:8], "little") < 1 << 32:
        return "safetensors"
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith(b"{") and (b'"asset"' in head or ending == "gltf"):
        return "gltf"
    if start.startswith((b"OFF", b"COFF")):
        return "off"
    if start.startswith(b"<") and b"<COLLADA" in head:
        return "dae"
    if is_ascii_stl(head) or (ending == "stl" and len(head) >= 84):
        return "stl"
    if ending == "splat":
        return "splat"
    if (advice := advice_for(head, ending)) is not None:
        raise FormatError(f"{advice}; {ACCEPTED}")
    if b"\0" not in head and ending != "txt" and _OBJ_LINE.search(head):
        return "obj"
    if b"\0" not in head and _POINT_LINE.search(head):
        return "points"
    raise FormatError(f"the file {filename[:80]!r} begins with {head[:8]!r}, which is of no known format; {ACCEPTED}")


def advice_for(head: bytes, ending: str) -> str | None:
    """Return the name of an unsupported format and what to do; None if it is unknown. `ending` is in lower case."""
    if not head:
        return "the file is empty; download or export it again"
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    for first, name, advice in _BY_BYTES:
        if start[: len(first)].lower() == first.lower():
            return f"{name} files are not read; {advice}"
    if start.startswith(b"{") and b'"lodLevels"' in head:
        return "splats in levels of detail (lod-meta.json) are not read; `splat-transform lod-meta.json tree.ply`"
    return f".{ending} files are not read; {_BY_ENDING[ending]}" if ending in _BY_ENDING else None
