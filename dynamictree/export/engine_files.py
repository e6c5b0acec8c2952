"""Writers of the products that game engines load beside a plain animated mesh."""

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from dynamictree.export.moving_tree import Facts, MovingTree, Report
from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.gltf.skin import Packing, joint_name, write_skinned_glb
from dynamictree.formats.stored_zip import write_stored_zip

if TYPE_CHECKING:
    from dynamictree.rig.branch_groups import Capsule
    from dynamictree.skin import Skin

COVERAGE = (0.5, 0.25, 0.1, 0.04, 0.0)
"""Share of the screen's height below which the next level is shown."""


def write_levels(tree: MovingTree, stream: BinaryIO, report: Report) -> Facts:
    """Write four levels of detail and cards, one GLB each, and their errors as JSON."""
    from dynamictree.export.levels import levels_of

    num_frames = tree.spectrum.num_frames
    levels = levels_of(tree.mesh, tree.coefficients, num_frames, lambda done: report(0.8 * done))
    errors = [asdict(level.error) | {"coverage": share} for level, share in zip(levels, COVERAGE, strict=True)]
    files = [("lod.json", json.dumps({"levels": errors}, indent=1).encode())]
    for number, level in enumerate(levels):
        report(0.8 + 0.2 * number / len(levels))
        single = io.BytesIO()
        level_mesh = replace(level.mesh, gltf=None)  # all levels have the same materials
        write_motion_glb(level_mesh, level.coefficients, single, num_frames=num_frames, fps=tree.loop_fps)
        files.append((f"tree-lod{number}.glb", single.getvalue()))
    write_stored_zip(stream, ((name, [content]) for name, content in files))
    coarsest = levels[-2].error
    facts: Facts = {
        "relative_error": coarsest.relative_error,
        "rms_error_m": coarsest.rms_error_m,
        "max_error_m": coarsest.max_error_m,
    }
    for number, level in enumerate(levels):
        facts[f"lod{number}_triangles"] = level.error.num_triangles
        facts[f"lod{number}_relative_error"] = level.error.relative_error
        facts[f"lod{number}_max_error_m"] = level.error.max_error_m
    return facts


def write_rig(tree: MovingTree, stream: BinaryIO, report: Report) -> Facts:
    """Write a skin with joints in the branches, Unreal's wind groups of its joints, and collision capsules."""
    engine_joints = 256  # joints per skinned mesh that Unity, Unreal and Godot accept
    from dynamictree.export.levels import wood_vertices
    from dynamictree.rig.branch_groups import capsules
    from dynamictree.rig.skin import reduce_rig, skin_of

    few = reduce_rig(tree.rig, tree.mesh.vertices, engine_joints)
    skin, summary = skin_of(tree.rig, tree.mesh.vertices, engine_joints)
    report(0.5)
    shapes = capsules(few, tree.mesh.vertices, wood_vertices(tree.mesh))
    rig = io.BytesIO()
    write_skinned_glb(tree.mesh, skin, summary, rig, fps=tree.loop_fps, packing=Packing(False, False))
    files = {
        "tree-rig.glb": rig.getvalue(),
        "collision.json": _text({"unit": "m", "axes": "+Y up", "capsules": [_described(one) for one in shapes]}),
        "dynamic-wind.json": _text(dynamic_wind(skin)),
    }
    write_stored_zip(stream, ((name, [content]) for name, content in files.items()))
    return asdict(summary)


def write_engine_wind(tree: MovingTree, stream: BinaryIO, report: Report) -> None:
    """Write wind that an engine evaluates itself: bones, cosines and shaders.

    Raises:
        InputError: the bones do not fit into a texture.
    """
    from dynamictree.export.engine_wind import engine_wind_files
    from dynamictree.modal.turbulence import turbulent_wind
    from dynamictree.rig.flutter import flutter_of

    wind = turbulent_wind(tree.spectrum, seed=tree.spectrum.seed)
    flutter = flutter_of(tree.rig, tree.spectrum, tree.params.flutter)
    write_stored_zip(stream, engine_wind_files(tree.mesh, wind, tree.rig, flutter))


def dynamic_wind(skin: "Skin") -> dict[str, object]:
    """Return the JSON that Unreal 5.7's Dynamic Wind imports for a skeletal mesh: a group per branch order.

    A group's influence is the bending of its joints in the motion, relative to the largest of all groups.
    """
    from dynamictree.rig.branch_groups import bending_rad, branch_orders

    order, bending = branch_orders(skin.parent), bending_rad(skin)
    spread = {number: np.quantile(bending[order == number], [0.1, 0.5, 0.9]) for number in np.unique(order).tolist()}
    largest = max(float(values[2]) for values in spread.values()) or 1.0
    groups = []
    for number, values in spread.items():
        low, middle, high = (round(float(value) / largest, 4) for value in values)
        groups.append(
            {
                "bUseDualInfluence": number > 0,
                "Influence": middle,
                "MinInfluence": low,
                "MaxInfluence": high,
                "ShiftTop": 0.0,
                "bIsTrunkGroup": number == 0,
            }
        )
    names = sorted(spread)
    joints = [
        {"JointName": joint_name(joint), "SimulationGroupIndex": names.index(number)}
        for joint, number in enumerate(order.tolist())
    ]
    return {"Joints": joints, "SimulationGroups": groups, "bIsGroundCover": False, "GustAttenuation": 0.0}


def _described(capsule: "Capsule") -> dict[str, object]:
    def y_up(point: Sequence[float]) -> list[float]:
        return [round(float(value), 5) for value in (point[0], point[2], -point[1])]

    ends = {"start_m": y_up(capsule.start_m.tolist()), "end_m": y_up(capsule.end_m.tolist())}
    return {"joint": joint_name(capsule.joint), **ends, "radius_m": round(capsule.radius_m, 5)}


def _text(content: dict[str, object]) -> bytes:
    return json.dumps(content, indent=1).encode()
