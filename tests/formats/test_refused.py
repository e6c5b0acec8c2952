"""Files of formats that are not read are refused with what to do."""

import pytest

from dynamictree.errors import FormatError
from dynamictree.formats.mesh_file import sniff_file_type
from tests.formats.meshes import zipped

LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 12\n"


@pytest.mark.parametrize(
    ("name", "content", "advice"),
    [
        ("tree.fbx", b"Kaydara FBX Binary  \0\x1a\0", "FBX files .* Blender .* glTF 2.0"),
        ("tree", b"; FBX 7.4.0 project file\n", "FBX files .* Blender"),
        ("tree.blend", b"BLENDER-v405", "Blender .* glTF 2.0"),
        ("compressed.blend", b"\x28\xb5\x2f\xfd\x01", r"\.blend files .* glTF 2.0"),
        ("tree.usdz", zipped({"tree.usdc": b"PXR-USDC"}), r"\.usdz files .* glTF 2.0"),
        ("tree.spm", b"SPM\1\1\1", "export it as glTF"),
        ("scan.e57", b"ASTM-E57\0\0", "CloudCompare"),
        ("scan.ptx", b"100\n200\n0 0 0\n1 0 0\n", "CloudCompare"),
        ("tree.ac", b"AC3Db\nMATERIAL bark\nv 0 0 0\n", "Assimp"),
        ("tree.x", b"xof 0303txt 0032\n", "Assimp"),
        ("tree.i3dm", b"i3dm\1\0\0\0", "3d-tiles-tools"),
        ("points.pnts", b"pnts\1\0\0\0", "LAS or LAZ"),
        ("part.step", b"ISO-10303-21;\nHEADER;\n", "STL"),
        ("trees.7z", b"7z\xbc\xaf\x27\x1c\0\4", "unpack"),
        ("tree.obj.gz", b"\x1f\x8b\x08\0\0", "unpack"),
        ("tree.glb", LFS, "git lfs pull"),
        ("tree.glb", b"<!DOCTYPE html><title>404</title>", "web page"),
        ("tree.glb", b"", "empty"),
        ("photo.heic", b"\0\0\0\x18ftypheic", "dynamictree reconstruct"),
        ("walk.mov", b"\0\0\0\x14ftypqt  ", "dynamictree reconstruct"),
        ("meta.lcc", b'{"version": "4.0", "guid": 1}', "splat-transform scene.lcc"),
        ("lod-meta.json", b'{"lodLevels": 4, "filenames": [], "tree": {}}', "splat-transform lod-meta.json"),
        ("tree.mtl", b"newmtl leaf\nKd 1 1 1\n", "give the OBJ"),
    ],
)
def test_what_is_not_read_is_refused_with_what_to_do(name: str, content: bytes, advice: str) -> None:
    with pytest.raises(FormatError, match=advice):
        sniff_file_type(content, name)
