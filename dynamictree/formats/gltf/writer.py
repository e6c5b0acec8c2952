"""Meshes as GLB: +Y up, metres, one primitive per material over shared vertices, in the mesh's vertex order."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float32, Shaped, UInt8

from dynamictree.byte_stream import ByteWriter
from dynamictree.color import srgb_to_linear
from dynamictree.formats.gltf.layout import WIDTHS, component_number
from dynamictree.formats.gltf.normals import rest_normals
from dynamictree.formats.gltf.webp import named_textures, webp_textures
from dynamictree.mesh import Material, TriangleMesh
from dynamictree.up_axis import up_rotation, vertices_in_source_axes

GENERATOR = "dynamictree"

VERTEX_BUFFER, _INDEX_BUFFER = 34962, 34963


@dataclass(kw_only=True)
class GlbWriter:
    """A glTF document under construction, and the bytes of its buffer."""

    root: dict[str, Any] = field(default_factory=dict)
    chunks: list[bytes] = field(default_factory=list)
    num_bytes: int = 0
    extras: dict[str, object] = field(default_factory=dict)  # extras of the asset

    def append(self, name: str, entry: object) -> int:
        """Append to a list of the document and return the index."""
        entries: list[object] = self.root.setdefault(name, [])
        entries.append(entry)
        return len(entries) - 1

    def add_bytes(self, content: bytes) -> int:
        """Add bytes, padded to a multiple of four, and return their offset."""
        start, padding = self.num_bytes, b"\0" * (-len(content) % 4)
        self.chunks += [content, padding] if padding else [content]
        self.num_bytes += len(content) + len(padding)
        return start

    def add_view(self, content: bytes, target: int | None = None) -> int:
        """Add a view of bytes and return its index."""
        view = {"buffer": 0, "byteOffset": self.add_bytes(content), "byteLength": len(content)}
        return self.append("bufferViews", view | ({} if target is None else {"target": target}))

    def add_accessor(
        self,
        elements: Shaped[np.ndarray, "count width"],
        *,
        target: int | None = None,
        bounds: bool = False,
        normalized: bool = False,
    ) -> int:
        """Add an array and return the accessor's index."""
        accessor: dict[str, object] = {
            "bufferView": self.add_view(np.ascontiguousarray(elements).tobytes(), target),
            "componentType": component_number(elements.dtype),
            "count": len(elements),
            "type": next(name for name, width in WIDTHS.items() if width == elements.shape[1]),
        }
        if bounds:
            accessor |= {"min": elements.min(axis=0).tolist(), "max": elements.max(axis=0).tolist()}
        if normalized:
            accessor["normalized"] = True
        return self.append("accessors", accessor)

    def finish(self, stream: ByteWriter) -> None:
        """Write the GLB file."""
        scene: dict[str, object] = {"scene": 0, "scenes": [{"nodes": [0]}]}
        asset: dict[str, Any] = {"version": "2.0", "generator": GENERATOR, **self.root.get("asset", {})}
        extras = asset.get("extras", {})
        if self.extras and isinstance(extras, dict):
            asset["extras"] = {**extras, **self.extras}
        buffer, *fallbacks = self.root.get("buffers", [{}])
        root = {**scene, **self.root, "asset": asset, "buffers": [{**buffer, "byteLength": self.num_bytes}, *fallbacks]}
        text = json.dumps(root, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + self.num_bytes
        stream.write(b"glTF" + b"".join(n.to_bytes(4, "little") for n in (2, length, len(text))) + b"JSON" + text)
        stream.write(self.num_bytes.to_bytes(4, "little") + b"BIN\0")
        for chunk in self.chunks:
            stream.write(chunk)


def write_glb(
    mesh: TriangleMesh, stream: ByteWriter, writer: GlbWriter | None = None, attributes: Mapping[str, int] | None = None
) -> None:
    """Write a mesh at rest with materials, textures and colours; `attributes` are further accessors of `writer`."""
    writer = writer or GlbWriter()
    add_mesh(writer, mesh, more_attributes=attributes)
    writer.append("nodes", {"mesh": 0, "name": "tree"})
    writer.finish(stream)


def rest_glb(mesh: TriangleMesh, lookup: Float32[np.ndarray, "N 2"]) -> bytes:
    """Return a GLB of the mesh at rest in one node, with a shader's lookup as TEXCOORD_1."""
    writer, stream = GlbWriter(), io.BytesIO()
    sets = {"TEXCOORD_1": lookup} | ({"TEXCOORD_0": np.zeros_like(lookup)} if mesh.look.uv is None else {})
    attributes = {name: writer.add_accessor(values, target=VERTEX_BUFFER) for name, values in sets.items()}
    write_glb(mesh, stream, writer, attributes)
    return stream.getvalue()


def add_mesh(
    writer: GlbWriter,
    mesh: TriangleMesh,
    *,
    targets: Sequence[dict[str, int]] = (),
    more_attributes: Mapping[str, int] | None = None,
    as_webp: bool = False,
) -> None:
    """Add the mesh, with morph targets and further attributes (accessors) that all of its primitives share."""
    attributes = {
        "POSITION": writer.add_accessor(vertices_in_source_axes(mesh.vertices, "+Y"), target=VERTEX_BUFFER, bounds=True)
    }
    normals = rest_normals(mesh) @ up_rotation("+Y").astype(np.float32)
    attributes["NORMAL"] = writer.add_accessor(normals, target=VERTEX_BUFFER)
    if mesh.look.uv is not None:
        attributes["TEXCOORD_0"] = writer.add_accessor(mesh.look.uv, target=VERTEX_BUFFER)
    if mesh.look.vertex_colors is not None:
        colors = linear_colors(mesh.look.vertex_colors)
        attributes["COLOR_0"] = writer.add_accessor(colors, target=VERTEX_BUFFER, normalized=True)
    attributes |= more_attributes or {}
    _add_materials(writer, mesh, as_webp=as_webp)
    primitives = []
    for number in np.unique(mesh.material_of_face):
        corners = mesh.faces[mesh.material_of_face == number].reshape(-1, 1).astype(np.uint32)
        primitive: dict[str, object] = {
            "attributes": attributes,
            "indices": writer.add_accessor(corners, target=_INDEX_BUFFER),
        }
        if mesh.look.materials:
            primitive["material"] = int(number)
        if targets:
            primitive["targets"] = list(targets)
        primitives.append(primitive)
    writer.append("meshes", {"name": "tree", "primitives": primitives})


def _add_materials(writer: GlbWriter, mesh: TriangleMesh, *, as_webp: bool) -> None:
    """Add the materials: the source glTF's if their textures use the mesh's only coordinates, else base colours."""
    source = {} if mesh.gltf is None else json.loads(mesh.gltf.document)
    has_uv = mesh.look.uv is not None

    def fits(material: object) -> bool:
        textures = [one for _, one in named_textures(material)]
        moved = any(one.get("texCoord") or "KHR_texture_transform" in one.get("extensions", {}) for one in textures)
        return has_uv >= bool(textures) and not moved

    entries = [entry if fits(entry) else None for entry in source.get("materials", [])]
    root: dict[str, Any] = {"materials": []}
    contents = list[bytes]()
    if mesh.gltf is not None and any(entry is not None for entry in entries):
        binary = b"".join(mesh.gltf.binary)
        root |= {name: source[name] for name in ("textures", "samplers", "images") if name in source}
        for image in root.get("images", []):
            view = source["bufferViews"][image["bufferView"]]
            start = view.get("byteOffset", 0)
            contents.append(binary[start : start + view["byteLength"]])
        text = json.dumps([entries, root.get("textures", [])])
        for listed in ("extensionsUsed", "extensionsRequired"):
            needed = [name for name in source.get(listed, []) if f'"{name}"' in text]
            root |= {listed: needed} if needed else {}
    entries += [None] * (len(mesh.look.materials) - len(entries))
    for material, entry in zip(mesh.look.materials, entries, strict=True):
        root["materials"].append(_material(root, contents, material, has_uv=has_uv) if entry is None else entry)
    if as_webp:
        webp_textures(root, contents)
    for image, content in zip(root.get("images", []), contents, strict=True):
        image["bufferView"] = writer.add_view(content)
    writer.root |= root if root["materials"] else {}


def _material(root: dict[str, Any], contents: list[bytes], material: Material, *, has_uv: bool) -> dict[str, object]:
    """Return a material of only a base colour, and add its texture."""
    surface: dict[str, object] = {
        "baseColorFactor": list(material.base_color),
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
    }
    if material.texture_png is not None and has_uv:
        textures, images = root.setdefault("textures", []), root.setdefault("images", [])
        surface["baseColorTexture"] = {"index": len(textures)}
        textures.append({"source": len(images)})
        images.append({"mimeType": "image/png"})
        contents.append(material.texture_png)
    entry: dict[str, object] = {"pbrMetallicRoughness": surface, "doubleSided": material.double_sided}
    if material.name:
        entry["name"] = material.name
    if material.blended:
        entry["alphaMode"] = "BLEND"
    elif material.alpha_cutoff is not None:
        entry |= {"alphaMode": "MASK", "alphaCutoff": material.alpha_cutoff}
    return entry


def linear_colors(colors: UInt8[np.ndarray, "N 4"]) -> Shaped[np.ndarray, "N 4"]:
    """Convert sRGB bytes to linear 16 bits: glTF's colours are linear, and linear bytes would lose dark shades."""
    rgba: Float32[np.ndarray, "N 4"] = colors.astype(np.float32) / 255
    rgba[:, :3] = srgb_to_linear(rgba[:, :3])
    return np.round(rgba * 65535).astype(np.uint16)
