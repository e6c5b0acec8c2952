"""Bring a swaying tree into Blender: imported, on the timeline, looping for ever, with a camera and a sun.

    blender --python recipes/blender_import.py -- tree.glb [picture.png]

With a second name, one frame is rendered there. Works with `tree.glb` and `tree-morph.glb`.
"""

import json
import struct
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

SKY = (0.45, 0.55, 0.65)


def loop_of(path: Path) -> tuple[float, int]:
    """Return the length of a GLB's first animation [s] and its number of keys, of which the last equals the first."""
    head = path.read_bytes()
    length = struct.unpack_from("<I", head, 12)[0]
    document = json.loads(head[20 : 20 + length])
    clock = document["accessors"][document["animations"][0]["samplers"][0]["input"]]
    return float(clock["max"][0]), int(clock["count"])


def timeline(duration_s: float, num_keys: int) -> tuple[int, int]:
    """Return frames per second and last frame of a timeline with one frame per key, without the repeated last key."""
    fps = round((num_keys - 1) / duration_s)
    return fps, num_keys - 2


def viewpoint(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return position and target of a 50 mm camera that sees a whole box from -Y and slightly above."""
    middle = tuple((a + b) / 2 for a, b in zip(low, high, strict=True))
    size = max(b - a for a, b in zip(low, high, strict=True))
    return (middle[0] + 0.4 * size, middle[1] - 3.4 * size, middle[2] + 0.15 * size), middle


def main(path: Path, picture: Path | None) -> None:
    import bpy
    from mathutils import Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    fps, last = timeline(*loop_of(path))
    scene = bpy.context.scene
    scene.render.fps, scene.frame_start, scene.frame_end = fps, 0, last
    bpy.ops.import_scene.gltf(filepath=str(path))
    for curve in (curve for action in bpy.data.actions for curve in curves_of(action)):
        curve.modifiers.new("CYCLES")
    corners = [
        thing.matrix_world @ Vector(corner) for thing in meshes_seen(scene.objects) for corner in thing.bound_box
    ]
    low, high = (tuple(pick(axis) for axis in zip(*corners, strict=True)) for pick in (min, max))
    place, aim = viewpoint(low, high)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = place
    camera.rotation_euler = (Vector(aim) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler, sun.data.energy = (0.7, 0.2, 0.5), 4.0
    for thing in (camera, sun):
        scene.collection.objects.link(thing)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("Sky")
    scene.world.color = SKY
    if scene.world.node_tree:  # Blender 5 draws the colour of a node only
        scene.world.node_tree.nodes["Background"].inputs[0].default_value = (*SKY, 1.0)
    if picture is not None:
        scene.frame_set(last // 2)
        scene.render.filepath = str(picture)
        bpy.ops.render.render(write_still=True)


def meshes_seen(things: Iterable[Any]) -> list[Any]:
    """Return the meshes in view, which the picture of a bone that Blender 5 puts at the origin is not."""
    return [thing for thing in things if thing.type == "MESH" and thing.visible_get()]


def curves_of(action: Any) -> list[Any]:
    """Return the curves of an action, from layers in Blender 4.4 and later, else directly."""
    layers = getattr(action, "layers", None)
    if not layers:
        return list(action.fcurves)
    return [curve for layer in layers for strip in layer.strips for bag in strip.channelbags for curve in bag.fcurves]


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if not 1 <= len(given) <= 2:
        raise SystemExit(__doc__)
    main(Path(given[0]), Path(given[1]) if len(given) == 2 else None)
