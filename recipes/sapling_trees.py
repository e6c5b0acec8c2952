"""Bake ten trees of Blender's Sapling add-on with its wind, for `dynamictree evaluate --samples FOLDER`.

    blender -b --factory-startup --python recipes/sapling_trees.py -- FOLDER

Writes FOLDER/sapling/NAME.npz, 190 MB in all, in half a minute. Tested with Blender 3.4.1 of Debian 12, which includes
the add-on (`add_curve_sapling`); numpy is Debian's python3-numpy. Every tree is a preset of the add-on with the changes
in `TREES`. The files have T = 100 frames at 24 Hz, N vertices, F triangles, B bones; lengths in metres, +Z up:

    rest [N, 3], vertices [T, N, 3]    rest pose and motion
    faces [F, 3]                       triangles
    part [N], comp [N]                 0 wood, 1 leaf; number of the vertex's stem or leaf
    bone [N]                           bone that moves the vertex; where two do, the later one
    bone_head, bone_tail [B, 3]        bones in the rest pose; parents come first
    bone_parent [B], bone_names [B]    -1 on the ground; `boneSSS.NNN`: stem and place in the stem
    bone_mats [T, B, 4, 4]             from the rest pose to each frame
    fps, preset, seed, params, meta    the last two are JSON: arguments of the add-on, figures of the bake
"""

import ast
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import addon_utils
import bpy
import numpy as np

ADD_ON = "add_curve_sapling"
TREES: tuple[tuple[str, int, dict[str, object]], ...] = (
    ("weeping_willow", 2789, {"levels": 3, "branches": [0, 14, 5, 0], "leaves": 24}),
    ("willow", 5, {"branches": [0, 12, 0, 0], "leaves": 60, "minRadius": 0.0015}),
    ("douglas_fir", 4, {"levels": 3, "branches": [0, 44, 6, 0], "leaves": 12, "closeTip": False}),
    ("douglas_fir", 0, {"levels": 3, "branches": [0, 44, 6, 0], "leaves": 12, "closeTip": False}),
    ("small_pine", 7, {"levels": 2, "branches": [0, 36, 7, 0], "leaves": 60}),
    ("white_birch", 0, {"levels": 3, "branches": [0, 18, 4, 0], "leaves": 16}),
    ("small_maple", 0, {"levels": 3, "branches": [0, 28, 5, 0], "leaves": 14}),
    ("japanese_maple", 0, {"levels": 3, "branches": [0, 8, 2, 0], "leaves": -3}),
    ("callistemon", 0, {"levels": 2, "branches": [0, 45, 0, 0], "leaves": 30}),
    ("quaking_aspen", 5, {"levels": 3, "branches": [0, 30, 6, 0], "leaves": 10}),
)
"""Preset, seed, and arguments that override the preset, so that a tree has 5,000 to 25,000 vertices."""
BAKE: dict[str, object] = {
    "bevel": True,
    "bevelRes": 0,  # rings of 4 vertices
    "resU": 2,
    "makeMesh": False,
    "useArm": True,
    "armAnim": True,
    "leafAnim": False,
    "showLeaves": True,
    "wind": 1.0,
    "gust": 1.0,
    "gustF": 0.075,
    "loopFrames": 0,
    "frameRate": 1.0,
    "previewArm": False,
    "armLevels": 2,
    "boneStep": [1, 1, 1, 1],
}
"""Arguments that all trees share: one bone per segment, rigid leaves, and the add-on's default wind without a loop."""
NOT_OF_THE_TREE = ("rna_type", "chooseSet", "presetName", "limitImport", "overwrite", "leafDupliObj")
"""Properties of the add-on's operator that belong to its menu."""
FRAMES = range(1, 101)
RING = 4  # vertices per ring
LEAF_VERTICES = {"hex": 6, "rect": 4}
STRETCH_STEP = 5  # interval of frames in which edges are measured
SHORTEST_EDGE_M = 1e-6


@dataclass(frozen=True, kw_only=True)
class Part:
    """Wood or leaves in the rest pose."""

    vertices: np.ndarray  # [N, 3] float32 [m]
    faces: np.ndarray  # [F, 3] int32
    comp: np.ndarray  # [N] int32
    bones: np.ndarray  # [N, 2] int32, each with weight 1/2


def main(folder: Path) -> None:
    """Bake every tree of `TREES` into the folder's subfolder `sapling`."""
    target = folder / "sapling"
    target.mkdir(parents=True, exist_ok=True)
    for preset, seed, changes in TREES:
        name = f"{preset}_s{seed}"
        start_scene()
        arguments = tree_arguments(preset, seed, changes)
        bpy.ops.curve.tree_add(**arguments)
        arrays = baked_tree(arguments)
        origin = {"preset": np.array(preset), "seed": np.int64(seed), "params": np.array(json.dumps(arguments))}
        np.savez_compressed(target / f"{name}.npz", **arrays, **origin)
        print(f"{name}: {len(arrays['rest'])} vertices, {len(arrays['bone_names'])} bones", flush=True)


def start_scene() -> None:
    """Empty Blender's scene and enable the add-on."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_utils.enable(ADD_ON)


def tree_arguments(preset: str, seed: int, changes: dict[str, object]) -> dict[str, Any]:
    """Return the add-on's arguments for a tree; those that neither the preset nor `BAKE` sets have its defaults."""
    properties = bpy.ops.curve.tree_add.get_rna_type().properties
    wanted = preset_arguments(preset) | BAKE | {"seed": seed} | changes | {"do_update": True}
    accepted = {name: setting for name, setting in wanted.items() if name in properties}  # old presets differ
    defaults = {
        one.identifier: list(one.default_array) if getattr(one, "is_array", False) else one.default
        for one in properties
        if one.identifier not in (*accepted, *NOT_OF_THE_TREE)
    }
    return accepted | defaults


def preset_arguments(name: str) -> dict[str, Any]:
    """Read a preset as the add-on's own `ImportData` does, with its conversions of old presets."""
    lines = (Path(sys.modules[ADD_ON].__file__).parent / "presets" / f"{name}.py").read_text().splitlines()
    settings: dict[str, Any] = ast.literal_eval(next(line for line in lines if line and not line.startswith("#")))
    if isinstance(settings["attractUp"], float):
        settings["attractUp"] = [0, 0, settings["attractUp"], settings["attractUp"]]
    if "leafDownAngle" not in settings:
        level = min(settings["levels"], 3)
        for old in ("downAngle", "downAngleV", "rotate", "rotateV"):
            settings[f"leaf{old[0].upper()}{old[1:]}"] = settings[old][level]
    return settings


def baked_tree(arguments: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays of the tree in the scene."""
    armature = bpy.data.objects["treeArm"]
    bones = list(armature.data.bones)
    row = {bone.name: number for number, bone in enumerate(bones)}
    parent = np.array([row[bone.parent.name] if bone.parent else -1 for bone in bones], np.int32)
    parts = [wood(row, parent), leaves(row, LEAF_VERTICES[arguments["leafShape"]])]
    rest = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([parts[0].faces, parts[1].faces + np.int32(len(parts[0].vertices))])
    bones_of_vertex = np.concatenate([part.bones for part in parts])
    mats = bone_matrices(armature, bones)
    vertices = moved_vertices(rest, bones_of_vertex, mats)
    size = {"bones": len(bones), "splines": len(bpy.data.objects["tree"].data.splines)}
    return {
        "faces": faces,
        "vertices": vertices,
        "rest": rest,
        "part": np.repeat([0, 1], [len(part.vertices) for part in parts]).astype(np.uint8),
        "comp": np.concatenate([part.comp for part in parts]),
        "bone": bones_of_vertex[:, 1],
        "bone_head": np.array([bone.head_local for bone in bones], np.float32),
        "bone_tail": np.array([bone.tail_local for bone in bones], np.float32),
        "bone_parent": parent,
        "bone_mats": mats,
        "bone_names": np.array(list(row)),
        "fps": np.float32(bpy.context.scene.render.fps),
        "meta": np.array(json.dumps(figures(rest, faces, vertices) | size)),
    }


def wood(row: dict[str, int], parent: np.ndarray) -> Part:
    """Return the stems as meshed by Blender: each spline is a tube of rings of 4 vertices.

    Args:
        row: number of a bone by its name.
        parent: parent of each bone; -1 on the ground.
    """
    tree = bpy.data.objects["tree"]
    tree.modifiers.clear()  # the armature's modifier would move the rest pose
    evaluated = tree.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    vertices, faces = places(mesh), triangles(mesh)
    evaluated.to_mesh_clear()
    pairs = [list(ring_bones(spline, number, row, parent)) for number, spline in enumerate(tree.data.splines)]
    rings = [len(of_spline) for of_spline in pairs]
    assert RING * sum(rings) == len(vertices), f"{sum(rings)} rings, but {len(vertices)} vertices"
    return Part(
        vertices=vertices,
        faces=faces,
        comp=np.repeat(np.arange(len(rings), dtype=np.int32), RING * np.array(rings)),
        bones=np.repeat(np.array([pair for of_spline in pairs for pair in of_spline], np.int32), RING, axis=0),
    )


def ring_bones(spline: Any, number: int, row: dict[str, int], parent: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield the two bones with weight 1/2 that move each ring of a stem: at a point, those that meet there."""
    points = spline.bezier_points
    own = [row[f"bone{number:03d}.{step:03d}"] for step in range(len(points) - 1)]
    below = int(parent[own[0]]) if parent[own[0]] >= 0 else own[0]
    yield below, own[0]
    for step, (point, end) in enumerate(pairwise(points)):
        if not point.handle_right_type == end.handle_left_type == "VECTOR":  # these have no ring midway
            yield own[step], own[step]
        yield own[step], own[min(step + 1, len(own) - 1)]


def leaves(row: dict[str, int], size: int) -> Part:
    """Return the leaves, each with the bone of its vertex group.

    Args:
        row: number of a bone by its name.
        size: vertices per leaf.
    """
    thing = bpy.data.objects["leaves"]
    vertices = places(thing.data)
    bone_of_group = {group.index: row[group.name] for group in thing.vertex_groups}
    bone = np.array([bone_of_group[vertex.groups[0].group] for vertex in thing.data.vertices], np.int32)
    return Part(
        vertices=vertices,
        faces=triangles(thing.data),
        comp=np.arange(len(vertices), dtype=np.int32) // size,
        bones=np.stack([bone, bone], axis=1),
    )


def places(mesh: Any) -> np.ndarray:
    """Return a mesh's vertices, [N, 3] [m]."""
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def triangles(mesh: Any) -> np.ndarray:
    """Return a mesh's polygons as fans of triangles, [F, 3]."""
    corners = (list(polygon.vertices) for polygon in mesh.polygons)
    return np.array([[own[0], *edge] for own in corners for edge in pairwise(own[1:])], np.int32)


def bone_matrices(armature: Any, bones: list[Any]) -> np.ndarray:
    """Return each bone's motion from the rest pose at every frame, [T, B, 4, 4]."""
    inverse = [bone.matrix_local.inverted() for bone in bones]
    mats = np.empty((len(FRAMES), len(bones), 4, 4), np.float32)
    for number, frame in enumerate(FRAMES):
        bpy.context.scene.frame_set(frame)
        posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        mats[number] = [posed[bone.name].matrix @ back for bone, back in zip(bones, inverse, strict=True)]
    return mats


def moved_vertices(rest: np.ndarray, bones: np.ndarray, mats: np.ndarray) -> np.ndarray:
    """Return the vertices at every frame, [T, N, 3] [m]; each follows the mean of its two bones."""
    homogeneous = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    moved = np.empty((len(mats), len(rest), 3), np.float32)
    for frame, of_bone in enumerate(mats.astype(np.float64)):
        moved[frame] = np.einsum("nij,nj->ni", of_bone[bones, :3].mean(axis=1), homogeneous)
    return moved


def figures(rest: np.ndarray, faces: np.ndarray, vertices: np.ndarray) -> dict[str, Any]:
    """Return versions, sizes [m], and how far edges stretch (1 is their length in the rest pose)."""
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[edge_lengths(rest, edges) > SHORTEST_EDGE_M]
    length = edge_lengths(rest, edges)
    stretch = np.stack([edge_lengths(moved, edges) / length for moved in vertices[::STRETCH_STEP]])
    distance = np.linalg.norm(vertices - rest, axis=2)
    return {
        "blender": bpy.app.version_string.split()[0],
        "addon": ADD_ON,
        "skin": "bones",
        "stretch_p999": float(np.percentile(stretch, 99.9)),
        "stretch_max": float(stretch.max()),
        "disp_max": float(distance.max()),
        "disp_mean": float(distance.mean()),
        "height": float(np.ptp(rest[:, 2])),
    }


def edge_lengths(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the length of each edge, [E] [m]."""
    return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if len(given) != 1:
        raise SystemExit(__doc__)
    main(Path(given[0]))
