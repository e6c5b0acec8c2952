"""The document that a motion is added to: the mesh's source document, or a new one.

Targets are attached primitive by primitive, in the primitive's own axes and units; what does not move gets none.
"""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64

from dynamictree.formats.gltf.normals import NormalError, angles_rad, turn_normals
from dynamictree.formats.gltf.scene import local_transform
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import SourceGltf, TriangleMesh
from dynamictree.skin import Skin
from dynamictree.up_axis import up_rotation

_Matrices = Float64[np.ndarray, "3 3"] | Float64[np.ndarray, "n 3 3"]


@dataclass(frozen=True, kw_only=True)
class MorphSlot:
    """A primitive of the file that targets can be attached to."""

    node: int
    primitive: int  # of the node's mesh
    rows: slice  # of the mesh's vertices
    to_local: _Matrices  # from displacements of the mesh to the primitive's own

    def local(self, displacement: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, "n 3"]:
        """The primitive's part of a displacement, in its own axes and units."""
        own = displacement[self.rows]
        if self.to_local.ndim == 2:
            return (own @ self.to_local.T).astype(np.float32)
        turned: Float32[np.ndarray, "n 3"] = np.einsum("nij,nj->ni", self.to_local, own).astype(np.float32)
        return turned

    def local_normals(self, normals: Float32[np.ndarray, "N 3"]) -> Float32[np.ndarray, "n 3"]:
        """The primitive's part of normals of the mesh, in its own axes."""
        return turn_normals(normals[self.rows], self.to_local)

    @property
    def metres_per_unit(self) -> float:
        """The most metres that a unit of the primitive's displacements can be."""
        return float(np.linalg.norm(np.linalg.pinv(self.to_local), 2, axis=(-2, -1)).max())

    def described(self) -> dict[str, object]:
        """Where the vertices are in the mesh, and the matrix from the primitive's displacements to +Z up and metres."""
        entry: dict[str, object] = {"node": self.node, "primitive": self.primitive, "first_vertex": self.rows.start}
        if self.to_local.ndim == 3:
            return entry  # a skin turns each vertex in its own way
        return entry | {"to_z_up_m": np.linalg.pinv(self.to_local).ravel().tolist()}  # by rows


@dataclass(kw_only=True)
class Template:
    """A document under construction, and where its vertices are in the mesh."""

    writer: GlbWriter
    slots: Sequence[MorphSlot]
    own_weights: dict[int, list[float]] = field(default_factory=dict)  # of the targets a morphing node had before
    moved: list[tuple[MorphSlot, list[dict[str, int]]]] = field(default_factory=list)  # that have normals, with targets
    still: dict[int, dict[str, int]] = field(default_factory=dict)  # targets of zeros, by their number of vertices

    def attach_targets(
        self, targets: Float32[np.ndarray, "M N 3"], moving: Bool[np.ndarray, " N"]
    ) -> tuple[list[int], list[dict[str, object]]]:
        """Attach targets to what moves.

        Returns:
            The nodes that then morph; and where the vertices of their primitives are in the mesh, for programs that
            look for them.
        """
        by_node: dict[int, dict[int, MorphSlot]] = {}
        for slot in self.slots:
            by_node.setdefault(slot.node, {})[slot.primitive] = slot
        nodes = [node for node, slots in by_node.items() if any(moving[slot.rows].any() for slot in slots.values())]
        written: dict[tuple[int, int, bytes], list[dict[str, int]]] = {}
        self.moved = []
        places: list[dict[str, object]] = []
        for node in nodes:
            mesh = self._own_mesh(node)
            for number, primitive in enumerate(mesh["primitives"]):
                place = by_node[node].get(number)
                if place is None or not moving[place.rows].any():
                    count = self.writer.root["accessors"][primitive["attributes"]["POSITION"]]["count"]
                    added = [self._zeros(count)] * len(targets)
                else:
                    key = (place.rows.start, place.rows.stop, place.to_local.tobytes())
                    if key not in written:
                        written[key] = [self._target(place, target) for target in targets]
                        places.append(place.described())
                        if "NORMAL" in primitive["attributes"]:
                            self.moved.append((place, written[key]))
                    added = written[key]
                primitive["targets"] = [*primitive.get("targets", []), *added]
            self._extend_weights(node, mesh, len(targets))
        return nodes, places

    def attach_joints(self, skin: Skin, skin_for: Callable[[Float64[np.ndarray, "4 4"]], int]) -> list[int]:
        """Attach joints and weights to what moves; gives the nodes that show it, which belong to the scene itself.

        `skin_for` adds a skin for meshes that a matrix places in the scene, and gives its number.
        """
        root, world = self.writer.root, _placed(self.writer.root)
        by_node: dict[int, dict[int, MorphSlot]] = {}
        for slot in self.slots:
            by_node.setdefault(slot.node, {})[slot.primitive] = slot
        skins: dict[bytes, int] = {}
        nodes = list[int]()
        for node, slots in by_node.items():
            if not any((skin.rows[slot.rows] * skin.weights[slot.rows]).any() for slot in slots.values()):
                continue
            for number, primitive in enumerate(self._own_mesh(node)["primitives"]):
                count = root["accessors"][primitive["attributes"]["POSITION"]]["count"]
                rows = slots[number].rows if number in slots else None
                primitive["attributes"] |= add_mesh_joints(self.writer, skin, rows, count)
            key = world[node].tobytes()
            if key not in skins:
                skins[key] = skin_for(world[node])
            entry = root["nodes"][node]
            fields = {name: entry.pop(name) for name in ("mesh", "weights") if name in entry}
            nodes.append(self.writer.append("nodes", {"name": "tree", "skin": skins[key], **fields}))
            self.slots = [replace(slot, node=nodes[-1]) if slot.node == node else slot for slot in self.slots]
        return nodes

    def attach_texture_coordinates(self, places: Float32[np.ndarray, "N 2"]) -> str:
        """Attach a set of texture coordinates after those that the primitives have; gives its name."""
        root = self.writer.root
        meshes = {slot.node: self._own_mesh(slot.node) for slot in self.slots}
        number = max(1, *(_num_texture_sets(p) for mesh in meshes.values() for p in mesh["primitives"]))
        written: dict[tuple[int, int], int] = {}
        zeros: dict[int, int] = {}
        for slot in self.slots:
            attributes = meshes[slot.node]["primitives"][slot.primitive]["attributes"]
            key = (slot.rows.start, slot.rows.stop)
            if key not in written:
                written[key] = self.writer.add_accessor(places[slot.rows], target=VERTEX_BUFFER)
            for gap in range(number):  # sets are numbered without gaps
                if f"TEXCOORD_{gap}" not in attributes:
                    count = root["accessors"][attributes["POSITION"]]["count"]
                    if count not in zeros:
                        zeros[count] = self.writer.add_accessor(np.zeros((count, 2), np.float32), target=VERTEX_BUFFER)
                    attributes[f"TEXCOORD_{gap}"] = zeros[count]
            attributes[f"TEXCOORD_{number}"] = written[key]
        return f"TEXCOORD_{number}"

    def attach_normals(
        self,
        rest: Float32[np.ndarray, "N 3"],
        frames: Callable[[], Iterable[Float32[np.ndarray, "N 3"]]],
        weights: Float64[np.ndarray, "T M"],
    ) -> NormalError:
        """Give targets the normals that, with the same weights, come nearest to those of the frames."""
        solve = np.linalg.pinv(weights).astype(np.float32)  # [M, T]
        still = [slot.local_normals(rest) for slot, _ in self.moved]
        deltas = [np.zeros((len(solve), *own.shape), np.float32) for own in still]
        for number, normals in enumerate(frames()):
            for (slot, _), own, delta in zip(self.moved, still, deltas, strict=True):
                delta += solve[:, number, None, None] * (slot.local_normals(normals) - own)
        count, squares, still_squares, largest = 0, 0.0, 0.0, 0.0
        for row, normals in zip(weights.astype(np.float32), frames(), strict=True):
            for (slot, _), own, delta in zip(self.moved, still, deltas, strict=True):
                truth = slot.local_normals(normals)
                angle = angles_rad(own + np.tensordot(row, delta, 1), truth)
                count += len(truth)
                squares += float((angle**2).sum())
                still_squares += float((angles_rad(own, truth) ** 2).sum())
                largest = max(largest, float(angle.max()))
        for (_, targets), delta in zip(self.moved, deltas, strict=True):
            for target, normals in zip(targets, delta, strict=True):
                target["NORMAL"] = self.writer.add_accessor(normals, target=VERTEX_BUFFER)
        return NormalError(
            normal_error_deg=math.degrees(math.sqrt(squares / max(count, 1))),
            max_normal_error_deg=math.degrees(largest),
            still_normal_error_deg=math.degrees(math.sqrt(still_squares / max(count, 1))),
        )

    def changes(
        self, changed: Mapping[int, Float32[np.ndarray, "n w"]], nodes: Sequence[int], count: int, num_vertices: int
    ) -> Float32[np.ndarray, "S N3"]:
        """What changes of accessors do to the mesh at rest and to its last `count` targets, in the mesh's axes [m]."""
        moved: Float32[np.ndarray, "S N 3"] = np.zeros((1 + count, num_vertices, 3), np.float32)
        for slot in self.slots:
            mesh = self.writer.root["meshes"][self.writer.root["nodes"][slot.node]["mesh"]]
            primitive = mesh["primitives"][slot.primitive]
            targets = primitive["targets"][-count:] if slot.node in nodes else []
            to_mesh = np.linalg.pinv(slot.to_local)
            for row, index in enumerate([primitive["attributes"]["POSITION"], *(one["POSITION"] for one in targets)]):
                if index in changed:
                    moved[row, slot.rows] = np.einsum(
                        "...ij,nj->ni" if to_mesh.ndim == 2 else "nij,nj->ni", to_mesh, changed[index]
                    )
        return moved.reshape(1 + count, -1)

    def _target(self, slot: MorphSlot, displacement: Float32[np.ndarray, "N 3"]) -> dict[str, int]:
        return {"POSITION": self.writer.add_accessor(slot.local(displacement), target=VERTEX_BUFFER, bounds=True)}

    def _own_mesh(self, node: int) -> dict[str, Any]:
        """The node's mesh; a copy of it if other nodes show it too."""
        root = self.writer.root
        index = root["nodes"][node]["mesh"]
        if sum(other.get("mesh") == index for other in root["nodes"]) > 1:
            root["nodes"][node]["mesh"] = self.writer.append("meshes", json.loads(json.dumps(root["meshes"][index])))
        mesh: dict[str, Any] = root["meshes"][root["nodes"][node]["mesh"]]
        return mesh

    def _zeros(self, count: int) -> dict[str, int]:
        """Accessor of zeros for a target without displacement; some players cannot read an accessor without a view."""
        if count not in self.still:
            zeros = np.zeros((count, 3), np.float32)
            self.still[count] = {"POSITION": self.writer.add_accessor(zeros, target=VERTEX_BUFFER, bounds=True)}
        return self.still[count]

    def _extend_weights(self, node: int, mesh: dict[str, Any], count: int) -> None:
        """Defaults and names of the targets that the mesh had before are followed by those of ours."""
        before = len(mesh["primitives"][0]["targets"]) - count
        entry = self.writer.root["nodes"][node]
        self.own_weights[node] = list(entry.get("weights") or mesh.get("weights") or [0.0] * before)
        for holder in (entry, mesh):
            if "weights" in holder:
                holder["weights"] = [*holder["weights"], *[0.0] * count]
        names = mesh.get("extras", {}).get("targetNames") if isinstance(mesh.get("extras"), dict) else None
        if isinstance(names, list) and before:
            mesh["extras"]["targetNames"] = [*names, *(f"sway_{number}" for number in range(count))]

    def add_sway(
        self, nodes: Sequence[int], times: Float32[np.ndarray, " T"], keys: Float32[np.ndarray, "T R"]
    ) -> dict[str, Any]:
        """Add the animation before the file's own; of these, what moved the same weights ends."""
        clock = self.writer.add_accessor(times[:, None], bounds=True)
        samplers, channels = list[object](), list[object]()
        of_defaults: dict[tuple[float, ...], int] = {}
        for node in nodes:
            defaults = tuple(self.own_weights[node])
            if defaults not in of_defaults:
                of_defaults[defaults] = len(samplers)
                whole = np.concatenate([np.tile(np.array(defaults, np.float32), (len(keys), 1)), keys], axis=1)
                output = self.writer.add_accessor(whole.reshape(-1, 1))
                samplers.append({"input": clock, "output": output, "interpolation": "LINEAR"})
            channels.append({"sampler": of_defaults[defaults], "target": {"node": node, "path": "weights"}})
        sway: dict[str, Any] = {"name": "sway", "samplers": samplers, "channels": channels}
        others = [_without_weights(entry, set(nodes)) for entry in self.writer.root.get("animations", [])]
        self.writer.root["animations"] = [sway, *(entry for entry in others if entry["channels"])]
        return sway


def add_mesh_joints(writer: GlbWriter, skin: Skin, rows: slice | None = slice(None), count: int = 0) -> dict[str, int]:
    """Attributes of some vertices; without rows, of `count` vertices that joint 0 carries, which never moves."""
    if rows is None:
        joints, weights = np.zeros((count, 4), np.int32), np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    else:
        weights = skin.weights[rows]
        joints = np.where(weights > 0, skin.rows[rows], 0)
    small = np.uint8 if len(skin.parent) <= np.iinfo(np.uint8).max + 1 else np.uint16
    shares = np.rint(255 * weights).astype(np.uint8)
    return {
        "JOINTS_0": writer.add_accessor(joints.astype(small), target=VERTEX_BUFFER),
        "WEIGHTS_0": writer.add_accessor(shares, target=VERTEX_BUFFER, normalized=True),
    }


def can_carry_joints(source: SourceGltf) -> bool:
    """Whether a document's nodes place each of its meshes once, and none by a skin."""
    root = json.loads(source.document)
    instanced = any("EXT_mesh_gpu_instancing" in node.get("extensions", {}) for node in root["nodes"])
    return source.to_vertex is None and not instanced and bool(root.get("scenes"))


def _placed(root: dict[str, Any]) -> dict[int, Float64[np.ndarray, "4 4"]]:
    """Where each node of the scene is."""
    waiting = [(node, np.eye(4)) for node in root["scenes"][root.get("scene", 0)]["nodes"]]
    placed: dict[int, Float64[np.ndarray, "4 4"]] = {}
    while waiting:
        node, above = waiting.pop()
        placed[node] = above @ local_transform(root["nodes"][node])
        waiting += [(child, placed[node]) for child in root["nodes"][node].get("children", [])]
    return placed


def open_template(mesh: TriangleMesh) -> Template:
    """The document of the mesh's source, else one mesh in one node."""
    if mesh.gltf is not None:
        return _of_source(mesh, mesh.gltf)
    writer = GlbWriter()
    add_mesh(writer, mesh)
    writer.append("nodes", {"mesh": 0, "name": "tree"})
    rows, to_local = slice(0, mesh.num_vertices), up_rotation("+Y").T
    primitives = range(len(writer.root["meshes"][0]["primitives"]))
    return Template(
        writer=writer, slots=[MorphSlot(node=0, primitive=i, rows=rows, to_local=to_local) for i in primitives]
    )


def _of_source(mesh: TriangleMesh, source: SourceGltf) -> Template:
    chunks = list(source.binary)
    writer = GlbWriter(root=json.loads(source.document), chunks=chunks, num_bytes=sum(map(len, chunks)))
    from_mesh = up_rotation(mesh.source.up_axis).T / mesh.source.scale
    if mesh.source.up_axis != "+Y" or mesh.source.scale != 1.0:
        _stand_upright(writer.root, np.linalg.inv(from_mesh))
    slots = []
    for (node, primitive, first, count), to_primitive in zip(
        source.primitives.tolist(), source.to_primitive, strict=True
    ):
        rows = slice(first, first + count)
        to_local = to_primitive @ from_mesh
        if source.to_vertex is not None:
            to_local = source.to_vertex[rows].astype(np.float64) @ to_local
        slots.append(MorphSlot(node=node, primitive=primitive, rows=rows, to_local=to_local))
    return Template(writer=writer, slots=slots)


def _stand_upright(root: dict[str, Any], to_z_up: Float64[np.ndarray, "3 3"]) -> None:
    """Put the scene below a node that turns and scales it to metres and +Y up, where the caller says it is not."""
    scene = root["scenes"][root.get("scene", 0)]
    matrix = np.eye(4)
    matrix[:3, :3] = up_rotation("+Y").T @ to_z_up
    root["nodes"].append({"name": "upright", "children": scene["nodes"], "matrix": matrix.T.ravel().tolist()})
    scene["nodes"] = [len(root["nodes"]) - 1]


def _num_texture_sets(primitive: dict[str, Any]) -> int:
    numbers = (name.removeprefix("TEXCOORD_") for name in primitive["attributes"] if name.startswith("TEXCOORD_"))
    return 1 + max((int(number) for number in numbers if number.isdecimal()), default=-1)


def _without_weights(animation: dict[str, Any], nodes: set[int]) -> dict[str, Any]:
    channels = [
        channel
        for channel in animation["channels"]
        if channel["target"].get("path") != "weights" or channel["target"].get("node") not in nodes
    ]
    return {**animation, "channels": channels}
