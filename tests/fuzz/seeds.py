"""Good files of every format that is read: what the mutations start from. Small, so that many fit into a minute."""

import gzip
import io
import json
import zlib

import laspy
import numpy as np
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
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import SurfaceVoxels
from tests.clouds import cloud_at
from tests.formats.ksplat_bytes import ksplat_bytes
from tests.formats.meshes import gltf_bytes, image_bytes, named_collada, triangle_gltf, trunk_and_crown, written, zipped


def tree() -> TriangleMesh:
    return trunk_and_crown(np.random.default_rng(1))


def cloud(degree: int, count: int = 40) -> GaussianCloud:
    rng = np.random.default_rng(degree)
    turned = rng.normal(size=(count, 4))
    return cloud_at(
        rng.normal(size=(count, 3)),
        turned=turned,
        scale=rng.uniform(0.01, 0.2, (count, 3)),
        opacity=rng.uniform(0.1, 0.9, count),
        sh=rng.normal(size=(count, (degree + 1) ** 2, 3)),
    )


def ascii_ply() -> bytes:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    body = "0 0 0 9 9 9\n1 0 0 9 9 9\n0 1 0 255 0 0\n0.3 0.3 2 0 1 2\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n"
    return (head + body).encode()


def stl(*, ascii_text: bool) -> bytes:
    mesh = tree()
    corners = mesh.vertices[mesh.faces].astype("<f4")
    if ascii_text:
        lines = ["solid tree"]
        for triangle in corners.tolist():
            lines += ["facet normal 0 0 1", "outer loop"]
            lines += ["vertex {:.6g} {:.6g} {:.6g}".format(*corner) for corner in triangle]
            lines += ["endloop", "endfacet"]
        return "\n".join([*lines, "endsolid tree", ""]).encode()
    row = np.zeros(len(corners), np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]))
    row["v"] = corners
    return bytes(80) + len(row).to_bytes(4, "little") + row.tobytes()


def las(*, packed: bool) -> bytes:
    points = np.random.default_rng(3).uniform(0, 5, (60, 3))
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.offsets, header.scales = np.zeros(3), np.full(3, 0.001)
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = points.T
    scan.red, scan.green, scan.blue = (points * 10_000).astype(np.uint16).T
    stream = io.BytesIO()
    scan.write(stream, do_compress=packed)
    return stream.getvalue()


def pcd(*, packed: bool) -> bytes:
    points = np.random.default_rng(5).uniform(0, 5, (60, 3)).astype("<f4")
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 1\n"
    head += "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 60\nDATA "
    if packed:
        return head.encode() + b"binary\n" + points.tobytes()
    return (head + "ascii\n" + "".join("{:.4f} {:.4f} {:.4f}\n".format(*row) for row in points.tolist())).encode()


def xyz(separator: str = " ") -> bytes:
    points = np.random.default_rng(4).uniform(0, 5, (60, 6))
    return "\n".join(separator.join(f"{value:.3f}" for value in row) for row in points).encode()


def grid() -> VoxelGrid:
    coords = np.argwhere(np.random.default_rng(5).random((6, 6, 6)) < 0.4).astype(np.int32)
    return VoxelGrid.from_coords(coords, origin_m=(-1.0, 0.0, 0.25), voxel_size_m=0.1, resolution=32)


def spectrum() -> bytes:
    voxels, rng = grid(), np.random.default_rng(6)
    parts = 0.1 * rng.normal(size=(len(voxels), 16, 3, 2)).astype(np.float32)
    return written(write_spectrum, SparseVoxelSpectrum(grid=voxels, coefficients=parts.view(np.complex64)[..., 0]))


def voxels() -> bytes:
    inside = grid()
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(inside), 1))
    return written(write_voxels, SurfaceVoxels(grid=inside, normals=normals))


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
        "stl": [stl(ascii_text=True), stl(ascii_text=False)],
        "glb": [written(write_glb, mesh), gltf_bytes(*triangle_gltf())],
        "dae": [named_collada()],
        "gltf-zip": [gltf_zip()],
        "obj-zip": [obj_zip()],
        "splat": [written(write_splat, cloud(0))],
        "spz": [written(write_spz, cloud(0)), written(write_spz, cloud(3)), spz4()],
        "sog": [written(write_sog, cloud(0)), written(write_sog, cloud(3))],
        "ksplat": [ksplat_bytes(cloud(degree), level) for degree, level in ((0, 0), (2, 1), (1, 2))],
        "las": [las(packed=False), las(packed=True)],
        "pcd": [pcd(packed=False), pcd(packed=True)],
        "xyz": [xyz(), xyz(", "), b"x y z\n" + xyz("\t")],
        "khr-glb": [written(write_gltf_gaussian, cloud(1))],
        "spectrum": [spectrum()],
        "voxels": [voxels()],
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
