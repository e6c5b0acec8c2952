"""Write many trees of one spectrum as a GLB: one mesh, and per tree a node with its own animation.

A phase per frequency, c_k e^{iθ_k}, gives another motion with the same spectrum: equally strong everywhere, equally
smooth and looped, but not just shifted in time. All trees lean the same way, since they stand in one wind.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex64, Float64

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import InputError
from dynamictree.formats.gltf.motion import clipped_targets, clipped_weights, loop_parts, loop_weights
from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, add_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.up_axis import up_rotation

INSTANCING = "EXT_mesh_gpu_instancing"


@dataclass(frozen=True, kw_only=True)
class StandingTree:
    """Position of one tree, and its differences from the others."""

    position_m: tuple[float, float, float]
    scale: float  # scale of the tree and its sway
    mirrored: bool  # mirrored at the vertical plane along the wind, so that its lean stays
    phase_rad: Float64[np.ndarray, " K"]  # phases; 0 for k = 0, the lean


@dataclass(frozen=True, kw_only=True)
class TravellingGusts:
    """Gusts that cross a forest: a tree repeats the sway of the one upwind, delayed by the gust's travel time."""

    speed_m_s: float  # speed of the gusts over the ground
    wind_deg: float  # direction to which the wind blows, from +X towards +Y
    period_s: float  # period of the loop
    variety: float = 0.25  # additional random difference of phases [turns]


def plant_forest(
    rng: np.random.Generator,
    count: int,
    *,
    num_frequencies: int,
    spacing_m: float,
    gusts: TravellingGusts | None = None,
) -> list[StandingTree]:
    """Draw trees on a jittered grid, 0.8 to 1.25 times as large as the first; phases at random, or by the gusts.

    Raises:
        InputError: there are no trees, or gusts have no speed.
    """
    if count < 1:
        raise InputError(f"{count} trees are asked for; at least 1 is needed")
    side = int(np.ceil(np.sqrt(count)))
    place = np.stack(np.divmod(np.arange(count), side), axis=1) - (side - 1) / 2  # [count, 2]
    place = (place + rng.uniform(-0.3, 0.3, place.shape)) * spacing_m
    phase = rng.uniform(0, 2 * np.pi, (count, num_frequencies))
    if gusts is not None:
        phase = gusts.variety * phase + _gust_phase(place, gusts, num_frequencies)
    phase[:, 0] = 0
    return [
        StandingTree(
            position_m=(float(x), float(y), 0.0),
            scale=float(1.25 ** rng.uniform(-1, 1)),
            mirrored=bool(rng.integers(2)),
            phase_rad=own,
        )
        for (x, y), own in zip(place, phase, strict=True)
    ]


def _gust_phase(
    place_m: Float64[np.ndarray, "n 2"], gusts: TravellingGusts, num_frequencies: int
) -> Float64[np.ndarray, "n K"]:
    """Return phases [rad] that delay each tree's motion by the travel time of the gust, per frequency."""
    if not gusts.speed_m_s > 0:
        raise InputError(f"gusts travel at {gusts.speed_m_s} m/s; a speed above 0 is needed")
    angle = np.deg2rad(gusts.wind_deg)
    delay_s = place_m @ [np.cos(angle), np.sin(angle)] / gusts.speed_m_s
    return np.asarray(-2 * np.pi * np.outer(delay_s / gusts.period_s, np.arange(num_frequencies)))


def write_forest_glb(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    trees: Sequence[StandingTree],
    stream: ByteWriter,
    *,
    num_frames: int,
    fps: float,
    wind_deg: float = 0.0,
    num_motions: int | None = None,
) -> None:
    """Write one period; keys as in `write_motion_glb`. The wind blows to `wind_deg`, from +X towards +Y.

    With `num_motions`, neighbours along the wind share a motion as GPU instances of one node (EXT_mesh_gpu_instancing),
    without mirroring, so a renderer draws each motion once.
    """
    writer = GlbWriter()
    rotation = up_rotation("+Y").astype(np.float32)
    foot = np.array([*mesh.vertices[:, :2].mean(axis=0), mesh.vertices[:, 2].min()], np.float32)
    targets = [
        {"POSITION": writer.add_accessor(target.reshape(-1, 3) @ rotation, target=VERTEX_BUFFER, bounds=True)}
        for target in clipped_targets(loop_parts(coefficients, num_frames))
    ]
    add_mesh(writer, mesh.with_vertices(mesh.vertices - foot), targets=targets)
    times = (np.arange(num_frames + 1) / fps).astype(np.float32)
    clock = writer.add_accessor(times[:, None], bounds=True)
    samplers, channels = list[object](), list[object]()
    groups = [[tree] for tree in trees] if num_motions is None else group_by_motion(trees, num_motions, wind_deg)
    for number, group in enumerate(groups):
        middle = group[len(group) // 2]
        weights = clipped_weights(loop_weights(coefficients.shape[1], num_frames, middle.phase_rad))
        keys = np.concatenate([weights, weights[:1]]).astype(np.float32).reshape(-1, 1)
        samplers.append({"input": clock, "output": writer.add_accessor(keys), "interpolation": "LINEAR"})
        channels.append({"sampler": number, "target": {"node": number, "path": "weights"}})
        if num_motions is None:
            writer.append("nodes", {"mesh": 0, "name": f"tree_{number}", **_placed(middle, rotation, wind_deg)})
        else:
            placed = {"extensions": {INSTANCING: {"attributes": _instances(writer, group, rotation)}}}
            writer.append("nodes", {"mesh": 0, "name": f"trees_{number}", **placed})
    if num_motions is not None:
        writer.root |= {name: [INSTANCING] for name in ("extensionsUsed", "extensionsRequired")}
    writer.append("scenes", {"nodes": list(range(len(groups)))})
    writer.append("animations", {"name": "sway", "samplers": samplers, "channels": channels})
    writer.finish(stream)


def group_by_motion(trees: Sequence[StandingTree], num_motions: int, wind_deg: float) -> list[list[StandingTree]]:
    """Divide trees into equal groups, in order along the wind.

    Raises:
        InputError: there is less than one motion, or there are more motions than trees.
    """
    if not 1 <= num_motions <= len(trees):
        raise InputError(f"{num_motions} motions are asked for; 1 to {len(trees)}, the number of trees, are possible")
    angle = np.deg2rad(wind_deg)
    along = np.array([tree.position_m[:2] for tree in trees]) @ [np.cos(angle), np.sin(angle)]
    return [[trees[i] for i in part] for part in np.array_split(np.argsort(along, kind="stable"), num_motions)]


def _instances(writer: GlbWriter, trees: Sequence[StandingTree], rotation: np.ndarray) -> dict[str, int]:
    """Write accessors of positions and scales, in glTF's axes."""
    places = np.array([tree.position_m for tree in trees]) @ rotation
    scales = np.repeat([[tree.scale] for tree in trees], 3, axis=1)
    return {
        name: writer.add_accessor(values.astype(np.float32))
        for name, values in (("TRANSLATION", places), ("SCALE", scales))
    }


def _placed(tree: StandingTree, rotation: np.ndarray, wind_deg: float) -> dict[str, object]:
    """Return translation, rotation and scale of a node, in glTF's axes."""
    node: dict[str, object] = {"translation": (np.array(tree.position_m) @ rotation).tolist()}
    if not tree.mirrored:
        return node | {"scale": [tree.scale] * 3}
    # the reflection along the wind is a reflection along x, then a rotation by twice the wind's direction
    half = np.deg2rad(wind_deg)
    turn = [0.0, float(np.sin(half)), 0.0, float(np.cos(half))]
    return node | {"rotation": turn, "scale": [tree.scale, tree.scale, -tree.scale]}
