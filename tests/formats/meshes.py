"""Small meshes that the tests of formats share."""

import io
import json
import zipfile
from collections.abc import Mapping

import numpy as np
from PIL import Image

from dynamictree.mesh import Material, MeshLook, TriangleMesh


def image_bytes(kind: str = "PNG", mode: str = "RGB", size: tuple[int, int] = (4, 4)) -> bytes:
    stream = io.BytesIO()
    Image.new(mode, size).save(stream, kind)
    return stream.getvalue()


def trunk_and_crown(rng: np.random.Generator, *, num_sides: int = 8) -> TriangleMesh:
    """A thin stem with a wide top, with materials, texture places and colours; vertices in no special order."""
    rings = [(0.0, 0.1), (2.0, 0.08), (2.2, 1.5), (4.0, 1.2), (5.0, 0.1)]
    angle = 2 * np.pi * np.arange(num_sides) / num_sides
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(num_sides)], axis=1)
    vertices = np.concatenate([circle * r + [0, 0, z] for z, r in rings])
    faces = []
    for ring in range(len(rings) - 1):
        for side in range(num_sides):
            a, b = ring * num_sides + side, ring * num_sides + (side + 1) % num_sides
            faces += [[a, b, b + num_sides], [a, b + num_sides, a + num_sides]]
    shuffled = rng.permutation(len(vertices))
    place = np.argsort(shuffled)
    face_array = place[np.array(faces)].astype(np.int32)
    return TriangleMesh(
        vertices=(vertices[shuffled] + [3.0, -1.0, 0.5]).astype(np.float32),
        faces=face_array,
        look=MeshLook(
            uv=rng.uniform(0, 1, (len(vertices), 2)).astype(np.float32),
            vertex_colors=rng.integers(0, 256, (len(vertices), 4)).astype(np.uint8),
            face_material=(np.arange(len(face_array)) >= 2 * num_sides).astype(np.int32),
            materials=(
                Material(name="bark", base_color=(0.3, 0.2, 0.1, 1.0)),
                Material(name="leaf", base_color=(0.1, 0.5, 0.1, 1.0), texture_png=image_bytes(), alpha_cutoff=0.5),
            ),
        ),
    )


def gltf_bytes(root: Mapping[str, object], binary: bytes = b"") -> bytes:
    """A GLB of any document."""
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = len(text).to_bytes(4, "little") + b"JSON" + text
    if binary:
        chunks += len(binary).to_bytes(4, "little") + b"BIN\0" + binary
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunks)).to_bytes(4, "little") + chunks


def triangle_gltf(**changes: object) -> tuple[dict[str, object], bytes]:
    """A document of one triangle, with some of its fields replaced."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    indices = np.array([0, 1, 2], np.uint16).tobytes()
    root: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6},
        ],
        "buffers": [{"byteLength": 42}],
    }
    return root | changes, positions + indices


def zipped(files: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()
