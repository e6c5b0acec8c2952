"""glTF documents as artists' tools write them, and what is in a document, with each index replaced by its content."""

import json
from typing import Any

import DracoPy
import numpy as np
from PIL import Image

from tests.formats.meshes import gltf_bytes, written

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Artist:
    """A document under construction."""

    def __init__(self, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        self.binary = b""
        self.root: dict[str, Any] = {"asset": {"version": "2.0", "generator": "easel 3", "copyright": "an artist"}}

    def add(self, name: str, entry: dict[str, Any]) -> int:
        self.root.setdefault(name, []).append(entry)
        return len(self.root[name]) - 1

    def view(self, content: bytes) -> int:
        entry = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)}
        self.binary += content + b"\0" * (-len(content) % 4)
        return self.add("bufferViews", entry)

    def accessor(self, values: np.ndarray, **more: object) -> int:
        width = 1 if values.ndim == 1 else values.shape[1]
        kind = next(number for number, dtype in COMPONENTS.items() if np.dtype(dtype) == values.dtype)
        entry = {"componentType": kind, "count": len(values), "type": next(t for t, w in WIDTHS.items() if w == width)}
        return self.add("accessors", entry | {"bufferView": self.view(values.tobytes())} | more)

    def image(self, kind: str = "PNG", **more: object) -> int:
        view = self.view(written(Image.fromarray(self.rng.integers(0, 255, (8, 8, 3), np.uint8)).save, format=kind))
        return self.add("images", {"bufferView": view, "mimeType": f"image/{kind.lower()}"} | more)

    def texture(self, kind: str = "PNG") -> int:
        sampler = self.add("samplers", {"wrapS": 33071, "magFilter": 9728})
        if kind == "WEBP":
            return self.add("textures", {"extensions": {"EXT_texture_webp": {"source": self.image("WEBP")}}})
        return self.add("textures", {"source": self.image(kind), "sampler": sampler, "extras": {"by": "hand"}})

    def cone(self, material: int | None = None, *, base: float = 0.0, **more: object) -> dict[str, Any]:
        """A primitive with all attributes that are usual: 24 vertices in three rings, around +Y."""
        angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
        rings = [(0.3, 0.0), (0.25, 1.5), (0.02, 3.0)]
        positions = np.concatenate(
            [np.stack([r * np.cos(angle), np.full(8, y + base), r * np.sin(angle)], axis=1) for r, y in rings]
        ).astype(np.float32)
        normals = positions * np.float32([1, 0, 1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        tangents = np.concatenate([normals[:, [2, 1, 0]] * np.float32([-1, 1, 1]), np.ones((24, 1))], axis=1)
        corner = np.arange(8)
        around = (corner + 1) % 8
        sides = np.stack([corner, corner + 8, around, around, corner + 8, around + 8])
        faces = np.concatenate([sides, sides + 8], axis=1).T
        uv = [self.rng.random((24, 2), np.float32) for _ in range(2)]
        attributes = {
            "POSITION": self.accessor(positions, min=positions.min(0).tolist(), max=positions.max(0).tolist()),
            "NORMAL": self.accessor(normals),
            "TANGENT": self.accessor(tangents.astype(np.float32)),
            "TEXCOORD_0": self.accessor(uv[0]),
            "TEXCOORD_1": self.accessor(uv[1]),
            "COLOR_0": self.accessor(self.rng.integers(0, 255, (24, 4), np.uint8), normalized=True),
            "_WIND": self.accessor(self.rng.random(24, np.float32)),
        }
        indices = self.accessor(faces.astype(np.uint16).ravel())
        more |= {} if material is None else {"material": material}
        return {"attributes": attributes, "indices": indices} | more

    def materials(self) -> list[int]:
        """A blended leaf, a cut-out leaf and a bark, with all kinds of textures."""
        turned = {"KHR_texture_transform": {"offset": [0.25, 0], "rotation": 0.5, "texCoord": 1}}
        used = ["KHR_texture_transform", "EXT_texture_webp", "KHR_materials_clearcoat", "KHR_materials_transmission"]
        self.root["extensionsUsed"] = [*used, "KHR_materials_variants", "KHR_lights_punctual"]
        bark = {
            "name": "bark",
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": self.texture("JPEG"), "extensions": turned},
                "metallicRoughnessTexture": {"index": self.texture(), "texCoord": 1},
                "roughnessFactor": 0.7,
            },
            "normalTexture": {"index": self.texture(), "scale": 0.5},
            "occlusionTexture": {"index": self.texture(), "strength": 0.4},
            "extensions": {
                "KHR_materials_clearcoat": {"clearcoatFactor": 1, "clearcoatTexture": {"index": self.texture()}}
            },
            "extras": {"shader": "oak"},
        }
        leaf = {
            "name": "leaf",
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": self.texture("WEBP")},
                "baseColorFactor": [1, 1, 1, 0.5],
            },
            "alphaMode": "BLEND",
            "doubleSided": True,
            "emissiveTexture": {"index": self.texture()},
            "emissiveFactor": [0.1, 0.2, 0],
            "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.3}},
        }
        cut = {"name": "needle", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True}
        return [self.add("materials", entry) for entry in (bark, leaf, cut)]

    def scene(self, *nodes: int, **more: object) -> None:
        own = {"nodes": list(nodes), "name": "garden", "extras": {"season": "autumn"}}
        self.root |= {"scene": 0, "scenes": [own | more]}

    def alone(self, primitive: dict[str, Any], *, mesh: dict[str, Any] | None = None, **node: object) -> "Artist":
        """With this primitive as its one mesh, in one node."""
        self.add("meshes", {"primitives": [primitive]} | (mesh or {}))
        self.add("nodes", {"mesh": 0, **node})
        self.scene(0)
        return self

    def glb(self) -> bytes:
        return gltf_bytes(self.root | {"buffers": [{"byteLength": len(self.binary)}]}, self.binary)


TURNED = {"rotation": [0, 0.6, 0, 0.8], "scale": [1.5, 2, 0.5], "translation": [1, 0.5, -2]}


def wooded() -> Artist:
    """A tree of nodes with two parts under turned and stretched nodes, a light, a camera and points."""
    artist = Artist()
    bark, leaf, cut = artist.materials()
    variants = {"KHR_materials_variants": {"mappings": [{"material": cut, "variants": [0]}]}}
    artist.root["extensions"] = {
        "KHR_materials_variants": {"variants": [{"name": "winter"}]},
        "KHR_lights_punctual": {"lights": [{"type": "directional", "name": "noon"}]},
    }
    crown = artist.cone(leaf, base=2.0, extensions=variants, extras={"species": "lime"})
    dust = {"attributes": {"POSITION": artist.accessor(np.zeros((5, 3), np.float32))}, "mode": 0}
    trunk = artist.add(
        "meshes", {"name": "trunk", "primitives": [artist.cone(bark), crown, dust], "extras": {"lod": 0}}
    )
    twig = artist.add("meshes", {"name": "twig", "primitives": [artist.cone(cut)]})
    artist.add("cameras", {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}})
    artist.add("nodes", {"name": "root", "children": [1, 3], "extras": {"id": 7}, "translation": [0, 0, 1]})
    artist.add("nodes", {"name": "tree", "mesh": trunk, "children": [2]})
    artist.add("nodes", {"name": "twig", "mesh": twig, **TURNED})
    artist.add("nodes", {"name": "eye", "camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}})
    artist.scene(0)
    return artist


def repeated() -> Artist:
    """One mesh in three nodes, one of them mirrored."""
    artist = Artist(1)
    mesh = artist.add(
        "meshes", {"name": "bush", "primitives": [artist.cone(artist.materials()[1])], "extras": {"a": 1}}
    )
    for number, more in enumerate(({}, TURNED, {"scale": [-1, 1, 1], "translation": [4, 0, 0]})):
        artist.add("nodes", {"name": f"bush {number}", "mesh": mesh, **more})
    artist.scene(0, 1, 2)
    return artist


def skinned() -> Artist:
    """A part that two joints place, and an animation of one of them."""
    artist = Artist(2)
    primitive = artist.cone(artist.materials()[0])
    upper = (np.arange(24) >= 12).astype(np.float32)
    primitive["attributes"] |= {
        "JOINTS_0": artist.accessor(np.tile(np.array([0, 1, 0, 0], np.uint8), (24, 1))),
        "WEIGHTS_0": artist.accessor(np.stack([1 - 0.7 * upper, 0.7 * upper, 0 * upper, 0 * upper], axis=1)),
    }
    artist.add("meshes", {"primitives": [primitive]})
    bind = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    bind[1, 3, 1] = -1
    artist.add("skins", {"joints": [1, 2], "inverseBindMatrices": artist.accessor(bind.reshape(2, 16)), "name": "rig"})
    artist.add("nodes", {"name": "body", "mesh": 0, "skin": 0})
    artist.add("nodes", {"name": "hip", "children": [2], "translation": [0.5, 0, 0]})
    artist.add("nodes", {"name": "head", "translation": [0, 1, 0], "rotation": [0, 0, 0.6, 0.8]})
    times, turns = np.float32([0, 1]), np.float32([[0, 0, 0.6, 0.8], [0, 0, 0, 1]])
    sampler = {"input": artist.accessor(times, min=[0], max=[1]), "output": artist.accessor(turns)}
    channel = {"sampler": 0, "target": {"node": 2, "path": "rotation"}}
    artist.add("animations", {"name": "nod", "samplers": [sampler], "channels": [channel]})
    artist.scene(0, 1)
    return artist


def morphing() -> Artist:
    """A part with a morph target of its own, half on."""
    artist = Artist(3)
    primitive = artist.cone(artist.materials()[0])
    primitive["targets"] = [{"POSITION": artist.accessor(artist.rng.random((24, 3), np.float32))}]
    names = {"targetNames": ["bloom"], "note": "spring"}
    return artist.alone(primitive, mesh={"name": "bud", "weights": [0.5], "extras": names})


def quantised() -> Artist:
    """Positions in normalised 16 bits, which the node makes as large as they are."""
    artist = Artist(4)
    artist.root["extensionsUsed"] = artist.root["extensionsRequired"] = ["KHR_mesh_quantization"]
    primitive = artist.cone()
    old = artist.root["accessors"][primitive["attributes"]["POSITION"]]
    floats = np.frombuffer(artist.binary, "<f4", 72, artist.root["bufferViews"][old["bufferView"]]["byteOffset"])
    shorts = np.zeros((24, 4), np.int16)
    shorts[:, :3] = np.round(floats.reshape(24, 3) / 3 * 32767)
    place = {"byteStride": 8, "byteOffset": len(artist.binary), "byteLength": 192}
    artist.root["bufferViews"][old["bufferView"]] |= place
    artist.binary += shorts.tobytes()
    bounds = {"min": shorts[:, :3].min(0).tolist(), "max": shorts[:, :3].max(0).tolist()}
    old |= {"componentType": 5122, "normalized": True} | bounds
    return artist.alone(primitive, scale=[3, 3, 3])


def instanced() -> Artist:
    """Three places of a mesh in one node."""
    artist = Artist(5)
    fern = artist.cone(artist.materials()[2])
    places = artist.accessor(np.float32([[0, 0, 0], [3, 0, 0], [0, 0, 4]]))
    sizes = artist.accessor(np.float32([[1, 1, 1], [2, 2, 2], [1, 0.5, 1]]))
    instancing = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places, "SCALE": sizes}}}
    artist.root["extensionsUsed"].append("EXT_mesh_gpu_instancing")
    artist.root["extensionsRequired"] = ["KHR_texture_transform"]
    return artist.alone(fern, name="ferns", extensions=instancing, extras={"count": 3}, **TURNED)


def plain() -> Artist:
    """A part as it is."""
    artist = Artist(6)
    return artist.alone(artist.cone(artist.materials()[0]))


def compressed() -> Artist:
    """The same as a Draco stream."""
    artist = Artist(6)
    primitive = artist.cone(artist.materials()[0])
    content = document_of(artist.glb())
    values = {name: content.accessor(index) for name, index in primitive["attributes"].items()}
    stream = DracoPy.encode(
        values["POSITION"],
        content.accessor(primitive["indices"]).reshape(-1, 3).astype(np.uint32),
        preserve_order=True,
        tex_coord=values["TEXCOORD_0"].astype(np.float64),
        normals=values["NORMAL"].astype(np.float64),
    )
    names = {0: "POSITION", 1: "NORMAL", 3: "TEXCOORD_0"}  # draco's attribute types
    identities = {names[int(a["attribute_type"])]: int(a["unique_id"]) for a in DracoPy.decode(stream).attributes}
    primitive["attributes"] = {name: primitive["attributes"][name] for name in identities}
    for index in (*primitive["attributes"].values(), primitive["indices"]):
        del artist.root["accessors"][index]["bufferView"]
    extension = {"bufferView": artist.view(stream), "attributes": identities}
    primitive["extensions"] = {"KHR_draco_mesh_compression": extension}
    artist.root["extensionsUsed"].append("KHR_draco_mesh_compression")
    artist.root["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return artist.alone(primitive)


class Document:
    """A GLB as it is, or JSON with the files beside it; read by nothing of ours."""

    def __init__(self, root: dict[str, Any], buffers: list[bytes], files: dict[str, bytes]) -> None:
        self.root, self.buffers, self.files = root, buffers, files

    def bytes_of(self, view: int) -> bytes:
        entry = self.root["bufferViews"][view]
        start = entry.get("byteOffset", 0)
        return self.buffers[entry["buffer"]][start : start + entry["byteLength"]]

    def accessor(self, index: int) -> np.ndarray:
        entry = self.root["accessors"][index]
        dtype, width = np.dtype(COMPONENTS[entry["componentType"]]), WIDTHS[entry["type"]]
        stride = self.root["bufferViews"][entry["bufferView"]].get("byteStride", dtype.itemsize * width)
        content, start = self.bytes_of(entry["bufferView"]), entry.get("byteOffset", 0)
        return np.ndarray((entry["count"], width), dtype, content, start, (stride, dtype.itemsize))

    def image(self, index: int) -> bytes:
        entry = self.root["images"][index]
        return self.files[entry["uri"]] if "uri" in entry else self.bytes_of(entry["bufferView"])


def document_of(glb: bytes) -> Document:
    length = int.from_bytes(glb[12:16], "little")
    return Document(json.loads(glb[20 : 20 + length]), [glb[20 + length + 8 :]], {})
