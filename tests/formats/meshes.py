"""Small meshes that the tests of formats share."""

import io
import json
import zipfile
from collections.abc import Callable, Mapping

import numpy as np
from PIL import Image

from dynamictree.formats.mesh_file import read_mesh
from dynamictree.mesh import Material, MeshLook, TriangleMesh


def read(content: bytes, file_type: str, **options: object) -> TriangleMesh:
    return read_mesh(io.BytesIO(content), file_type=file_type, **options)


def written(write: Callable[..., object], *what: object, **options: object) -> bytes:
    stream = io.BytesIO()
    write(*what, stream, **options)
    return stream.getvalue()


def image_bytes(kind: str = "PNG", mode: str = "RGB", size: tuple[int, int] = (4, 4)) -> bytes:
    return written(Image.new(mode, size).save, format=kind)


def png_of(pixels: np.ndarray) -> bytes:
    return written(Image.fromarray(pixels).save, format="PNG")


def trunk_and_crown(rng: np.random.Generator, *, num_sides: int = 8) -> TriangleMesh:
    """A thin stem with a wide top, with materials, texture places and colours; vertices in no special order."""
    rings = [(0.0, 0.1), (2.0, 0.08), (2.2, 1.5), (4.0, 1.2), (5.0, 0.1)]
    angle = 2 * np.pi * np.arange(num_sides) / num_sides
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(num_sides)], axis=1)
    vertices = np.concatenate([circle * r + [0, 0, z] for z, r in rings])
    a = np.arange((len(rings) - 1) * num_sides)
    b = a // num_sides * num_sides + (a + 1) % num_sides
    faces = np.stack([a, b, b + num_sides, a, b + num_sides, a + num_sides], axis=1).reshape(-1, 3)
    shuffled = rng.permutation(len(vertices))
    face_array = np.argsort(shuffled)[faces].astype(np.int32)
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


def zipped(files: Mapping[str, bytes], kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", kind) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def named_collada() -> bytes:
    """COLLADA with named nodes, one below another, and a material that is bound to each geometry."""
    square = "<float_array id='{0}f' count='12'>0 0 0 1 0 0 1 0 2 0 0 2</float_array>"
    source = "<source id='{0}s'>" + square + "<technique_common><accessor source='#{0}f' count='4' stride='3'>"
    source += "<param name='X' type='float'/><param name='Y' type='float'/><param name='Z' type='float'/>"
    source += "</accessor></technique_common></source><vertices id='{0}v'><input semantic='POSITION' source='#{0}s'/>"
    source += "</vertices><triangles material='m' count='{1}'><input semantic='VERTEX' source='#{0}v' offset='0'/>"
    source += "<p>{2}</p></triangles>"
    geometry = "<geometry id='{0}' name='{3}'><mesh>" + source + "</mesh></geometry>"
    placed = "<instance_geometry url='#{0}'><bind_material><technique_common><instance_material symbol='m' "
    placed += "target='#{1}'/></technique_common></bind_material></instance_geometry>"
    effect = "<effect id='e{0}'><profile_COMMON><technique sid='c'><lambert/></technique></profile_COMMON></effect>"
    text = (
        "<COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema' version='1.4.1'><asset><up_axis>Z_UP</up_axis>"
        f"</asset><library_effects>{effect.format(0)}</library_effects><library_materials>"
        "<material id='m0' name='bark'><instance_effect url='#e0'/></material></library_materials>"
        f"<library_geometries>{geometry.format('a', 2, '0 1 2 0 2 3', 'Trunk')}"
        f"{geometry.format('b', 1, '0 1 2', 'Cylinder')}</library_geometries>"
        "<library_visual_scenes><visual_scene id='s'>"
        f"<node id='n0' name='Trunk'>{placed.format('a', 'm0')}</node>"
        f"<node id='n1' name='Pots'><node name='FlowerPot'>{placed.format('b', 'm0')}</node>"
        f"<node name='Saucer'>{placed.format('b', 'm0')}</node></node>"
        "</visual_scene></library_visual_scenes><scene><instance_visual_scene url='#s'/></scene></COLLADA>"
    )
    return text.encode()
