"""Good files of every format that is read: what the mutations start from. Small, so that many fit into a minute."""

import gzip
import io
import json
import zlib
from dataclasses import replace

import numpy as np
import trimesh
import zstandard
from PIL import Image

from dynamictree.formats.gltf.gaussian import write_gltf_gaussian
from dynamictree.formats.gltf.writer import write_glb
from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.formats.splat.sog import write_sog
from dynamictree.formats.splat.splat import write_splat
from dynamictree.formats.splat.spz import write_spz
from dynamictree.formats.tensors.bundle import write_bundle
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.formats.tensors.voxels import write_voxels
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import TriangleMesh
from tests.formats.ksplat_bytes import ksplat_bytes
from tests.formats.meshes import gltf_bytes, image_bytes, named_collada, triangle_gltf, trunk_and_crown, written, zipped
from tests.formats.test_cloud_round_trips import make_cloud
from tests.formats.test_point_clouds import las_of
from tests.formats.test_point_text import pcd
from tests.formats.test_tensor_files import small_spectrum, small_voxels


def tree() -> TriangleMesh:
    return trunk_and_crown(np.random.default_rng(1))


def cloud(degree: int) -> GaussianCloud:
    return make_cloud(np.random.default_rng(degree), 40, degree=degree)


def points(columns: int = 3) -> np.ndarray:
    return np.random.default_rng(4).uniform(0, 5, (60, columns))


def las(*, packed: bool) -> bytes:
    colors = np.random.default_rng(3).integers(0, 256, (60, 3))
    return las_of(points(), colors, packed=packed).getvalue()


def stl(kind: str) -> bytes:
    mesh = tree()
    content = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type=kind)
    return content.encode() if isinstance(content, str) else content


def ascii_ply() -> bytes:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    body = "0 0 0 9 9 9\n1 0 0 9 9 9\n0 1 0 255 0 0\n0.3 0.3 2 0 1 2\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
    return (head + body).encode()


def xyz(separator: str = " ") -> bytes:
    return "\n".join(separator.join(f"{value:.3f}" for value in row) for row in points(6)).encode()


def photo(kind: str, mode: str = "RGB", seed: int = 7) -> bytes:
    pixels = np.random.default_rng(seed).integers(0, 256, (240, 320, 3), np.uint8)
    stream = io.BytesIO()
    picture = Image.fromarray(pixels).resize((40, 30)).resize((320, 240)).convert(mode)
    picture.save(stream, kind, quality=40) if kind == "JPEG" else picture.save(stream, kind)
    return stream.getvalue()


def gltf_zip() -> bytes:
    root, binary = triangle_gltf()
    root |= {"buffers": [{"byteLength": 42, "uri": "tree.bin"}], "images": [{"uri": "bark.png"}]}
    root |= {"textures": [{"source": 0}], "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
    files = {"tree.gltf": json.dumps(root).encode(), "tree.bin": binary, "bark.png": image_bytes()}
    return zipped(files)


def obj_zip() -> bytes:
    stream = io.BytesIO()
    beside = write_obj(tree(), stream, library="tree.mtl")
    return zipped({"tree.obj": stream.getvalue(), **beside})


def photo_zip() -> bytes:
    return zipped({f"{number}.jpg": photo("JPEG", seed=number) for number in range(8)})


def spz4() -> bytes:
    """Version 4, which nothing of ours writes: a plain header, a table, a zstandard stream an attribute."""
    legacy = gzip.decompress(written(write_spz, cloud(0)))
    count = 40
    sizes = [count * width for width in (9, 1, 3, 3, 4)]
    parts, at = [], 16
    for size in sizes:
        parts.append(legacy[at : at + size])
        at += size
    streams = [zstandard.compress(part) for part in (*parts, b"")]
    table = b"".join(
        len(stream).to_bytes(8, "little") + len(part).to_bytes(8, "little")
        for stream, part in zip(streams, (*parts, b""), strict=True)
    )
    head = b"NGSP" + (4).to_bytes(4, "little") + count.to_bytes(4, "little") + bytes([0, legacy[13], 0, 6])
    return head + (32).to_bytes(4, "little") + bytes(12) + table + b"".join(streams)


def seeds() -> dict[str, list[bytes]]:
    """Good files by format. The formats are the fuzzer's columns."""
    mesh = tree()
    return {
        "obj": [written(write_obj, mesh), b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 2\nf 1 2 3\nf 1//1 2//1 4//1\n"],
        "ply-mesh": [written(write_ply, mesh), ascii_ply()],
        "ply-splat": [written(write_gaussian_ply, cloud(degree)) for degree in (0, 3)],
        "stl": [stl("stl_ascii"), stl("stl")],
        "glb": [written(write_glb, mesh), gltf_bytes(*triangle_gltf())],
        "dae": [named_collada()],
        "gltf-zip": [gltf_zip()],
        "obj-zip": [obj_zip()],
        "splat": [written(write_splat, cloud(0))],
        "spz": [written(write_spz, cloud(0)), written(write_spz, cloud(3)), spz4()],
        "sog": [written(write_sog, cloud(0)), written(write_sog, cloud(3))],
        "ksplat": [ksplat_bytes(cloud(degree), level) for degree, level in ((0, 0), (2, 1), (1, 2))],
        "las": [las(packed=False), las(packed=True)],
        "pcd": [pcd("ascii"), pcd("binary")],
        "xyz": [xyz(), xyz(", "), b"x y z\n" + xyz("\t")],
        "khr-glb": [written(write_gltf_gaussian, cloud(1))],
        "spectrum": [written(write_spectrum, small_spectrum(np.random.default_rng(5)))],
        "voxels": [written(write_voxels, replace(small_voxels(np.random.default_rng(5)), moments=None))],
        "mesh-bundle": [written(write_bundle, mesh)],
        "jpeg": [photo("JPEG"), photo("JPEG", "L")],
        "png": [photo("PNG"), photo("PNG", "P")],
        "webp-tiff": [photo("WEBP"), photo("TIFF")],
        "zip": [photo_zip()],
    }


def inflate(content: bytes) -> bytes | None:
    """What a gzip holds; None where it is none."""
    try:
        return gzip.decompress(content)
    except (OSError, EOFError, zlib.error):
        return None
