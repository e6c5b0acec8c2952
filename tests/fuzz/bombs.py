"""Expansion bombs: small files that name far more than they hold. Each must be refused, or read in bounded memory."""

import io
import json
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

from dynamictree.formats.mesh_file import read_mesh
from dynamictree.reconstruct.input_cameras import find_input_cameras
from dynamictree.render.appearance import appearance_of
from tests.formats.meshes import gltf_bytes, triangle_gltf, written, zipped
from tests.fuzz.readers import READERS

MOST_MIB = 400
"""What a bomb may take, on top of the parser itself with all that it has imported, and of its own bytes."""


def one_image_of_many_materials() -> bytes:
    """One picture that 150 materials name: mip levels were made of it for each."""
    return _textured(num_images=1, num_materials=150, side_px=1024)


def many_images() -> bytes:
    """Sixty pictures of one colour, 16 MP each."""
    return _textured(num_images=60, num_materials=60, side_px=4096)


def many_instances() -> bytes:
    """EXT_mesh_gpu_instancing with twelve million places, in an accessor without a buffer: all zero."""
    root, binary = triangle_gltf(extensionsUsed=["EXT_mesh_gpu_instancing"])
    root["accessors"].append({"componentType": 5126, "type": "VEC3", "count": 12_000_000})
    root["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}}
    return gltf_bytes(root, binary)


def spz_of_zeros() -> bytes:
    """Five million Gaussians of degree 3 in 316 kB."""
    count = 5_000_000
    header = struct.pack("<IIIBBBB", 0x5053474E, 3, count, 3, 12, 0, 0)
    size = count * (9 + 1 + 3 + 3 + 4 + 45)
    packer = zlib.compressobj(9, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    parts = [packer.compress(header)]
    chunk = bytes(1 << 20)
    for start in range(0, size, len(chunk)):
        parts.append(packer.compress(chunk[: size - start]))
    return b"".join([*parts, packer.flush()])


def sog_of_one_colour() -> bytes:
    """Five million Gaussians of degree 3 in pictures of one colour, which lossless WebP packs 10,000 to one."""
    count, side = 5_000_000, 2240
    picture, palette = (io.BytesIO() for _ in range(2))
    Image.new("RGBA", (side, side)).save(picture, "WEBP", lossless=True)
    Image.new("RGBA", (64 * 15, 1)).save(palette, "WEBP", lossless=True)
    names = {"means": ("l", "u"), "scales": ("s",), "quats": ("q",), "sh0": ("c",), "shN": ("p", "n")}
    meta: dict[str, Any] = {name: {"files": list(files), "codebook": [0.0] * 256} for name, files in names.items()}
    meta["means"] |= {"mins": [0, 0, 0], "maxs": [1, 1, 1]}
    meta["shN"] |= {"bands": 3, "count": 64}
    files = {name: picture.getvalue() for group in names.values() for name in group} | {"p": palette.getvalue()}
    return zipped(files | {"meta.json": json.dumps(meta | {"version": 2, "count": count}).encode()}, zipfile.ZIP_STORED)


def cameras_of_nothing() -> bytes:
    """A `transforms.json` of 120 MB that packs into 2 MB: numbers of one digit, each 32 bytes in memory."""
    frame = {"file_path": "a.jpg", "transform_matrix": [[0] * 4] * 4, "more": [[]] * 40_000_000}
    return json.dumps(frame, separators=(",", ":")).encode()


def sparse_accessor() -> bytes:
    """A glTF mesh of 200 million vertices, all zero but one: `sparse` without a buffer."""
    root, binary = triangle_gltf(meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}])
    root["accessors"][0] = {"componentType": 5126, "type": "VEC3", "count": 200_000_000}
    return gltf_bytes(root, binary)


def photo_of_one_colour() -> bytes:
    """A PNG of 30,000 by 30,000 pixels in 110 kB."""
    size = 30_000
    header = struct.pack(">IIBBBBB", size, size, 1, 0, 0, 0, 0)
    packer = zlib.compressobj(9)
    row = bytes(1 + size // 8)
    rows = b"".join(packer.compress(row) for _ in range(size)) + packer.flush()
    chunks = ((b"IHDR", header), (b"IDAT", rows), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )


def zip_of_zeros() -> bytes:
    """A gigabyte of zeros, declared as it is, in 4.5 MB."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for number in range(4):
            with archive.open(f"{number}.ply", "w") as target:
                for _ in range(16):
                    target.write(bytes(1 << 24))
    return content.getvalue()


def zip_of_cameras() -> bytes:
    """The same as an upload, beside photos."""
    files = {"transforms.json": cameras_of_nothing()}
    for number in range(8):
        files[f"{number}.jpg"] = written(Image.effect_noise((640, 480), 60).save, format="JPEG", quality=95)
    return zipped(files)


def _cameras(content: bytes) -> object:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "transforms.json").write_bytes(content)
        return find_input_cameras(Path(folder), {"a.jpg": ((640, 480), (640, 480))})


def _looks(content: bytes) -> object:
    return appearance_of(read_mesh(io.BytesIO(content), file_type="glb"))


BOMBS: dict[str, tuple[Callable[[], bytes], Callable[[bytes], object], str]] = {
    "one image of many materials": (one_image_of_many_materials, _looks, "read"),
    "many images": (many_images, _looks, "refused"),
    "many instances": (many_instances, READERS["glb"], "refused"),
    "spz of zeros": (spz_of_zeros, READERS["spz"], "refused"),
    "SOG of one colour": (sog_of_one_colour, READERS["sog"], "refused"),
    "cameras of nothing": (cameras_of_nothing, _cameras, "refused"),
    "zip of cameras": (zip_of_cameras, READERS["zip"], "refused"),
    "sparse accessor": (sparse_accessor, READERS["glb"], "refused"),
    "photo of one colour": (photo_of_one_colour, READERS["png"], "refused"),
    "zip of zeros": (zip_of_zeros, READERS["zip"], "refused"),
}
"""How a bomb is made, what reads it, and what should come of it."""


def _textured(*, num_images: int, num_materials: int, side_px: int) -> bytes:
    root, corners = triangle_gltf(images=[], textures=[], materials=[])
    binary = bytearray(corners + b"\0\0")
    for number in range(num_images):
        picture = io.BytesIO()
        Image.new("L", (side_px, side_px), number).save(picture, "PNG", compress_level=9)
        root["images"].append({"bufferView": len(root["bufferViews"]), "mimeType": "image/png"})
        root["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": picture.tell()})
        root["textures"].append({"source": number})
        binary += picture.getvalue() + bytes(-picture.tell() % 4)
    for number in range(num_materials):
        texture = {"index": number % num_images}
        root["materials"].append({"pbrMetallicRoughness": {"baseColorTexture": texture}, "name": str(number)})
    primitive = root["meshes"][0]["primitives"][0]
    root["meshes"][0]["primitives"] = [primitive | {"material": number} for number in range(num_materials)]
    return gltf_bytes(root | {"buffers": [{"byteLength": len(binary)}]}, bytes(binary))
