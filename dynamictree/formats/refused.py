"""Advice for files of formats that are not read: what to export or unpack instead."""

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
