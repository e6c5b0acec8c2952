"""Made inputs of kinds that were once taken wrongly, and what must be stated of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from dynamictree.commands.input_files import is_cloud, load_capture, load_mesh
from dynamictree.errors import DynamicTreeError
from dynamictree.formats.description import describe_capture, describe_mesh
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud, join_clouds
from dynamictree.gaussian.from_mesh import splats_of_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.capture import moving_part
from dynamictree.source import Source
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES
from tests.formats.meshes import written

Verdict = Mapping[str, Any]
"""As `verdict` gives it."""


def verdict(path: Path) -> dict[str, Any]:
    """What a user reads of a file, or why it is refused."""
    try:
        if is_cloud(path):
            capture = load_capture(path)
            stated = describe_capture(capture)
            still = stated["num_gaussians"] - stated["num_movable"]
            moving = capture.cloud.means[moving_part(capture)]
        else:
            mesh = load_mesh(path)
            stated = describe_mesh(mesh)
            still = stated["num_still_faces"]
            moving = mesh.vertices[mesh.moving_part.faces.ravel()]
    except DynamicTreeError as error:
        return {"error": str(error)}
    return {
        "up": stated["source_up_axis"],
        "confidence": stated.get("source_up_confidence"),
        "extent_m": stated["extent_m"],
        "moving_height_m": round(float(np.ptp(moving[:, 2])), 3),
        "unit_m": stated["source_scale"],
        "still": still,
        "of": stated.get("num_faces") or stated.get("num_gaussians"),
        "still_parts": [part["name"] for part in stated["still_parts"]],
        "trees": len(stated["trees"]),
        "warnings": [warning["code"] for warning in stated["warnings"]],
    }


@dataclass(frozen=True)
class Kind:
    """One input, by its bytes, and whether what is stated of it is right."""

    content: Callable[[], bytes]
    is_right: Callable[[Verdict], bool]
    file_type: str = "glb"


@cache
def grown(species: str, seed: int = 0, *, base_size: float | None = None, hang: float = 0.0) -> trimesh.Trimesh:
    """A tree without names, its foot at 0; `hang` draws its branches down and makes them longer."""
    habit = SPECIES[species]
    levels = tuple(
        replace(level, tropism=level.tropism - hang, length=level.length * (1.3 if number and hang else 1))
        for number, level in enumerate(habit.levels)
    )
    low = habit.base_size if base_size is None else base_size
    mesh = grow_tree(replace(habit, levels=levels, base_size=low), np.random.default_rng([seed, 7])).mesh
    return trimesh.Trimesh(mesh.vertices - [0, 0, mesh.vertices[:, 2].min()], mesh.faces, process=False)


def exported(*parts: trimesh.Trimesh, names: tuple[str, ...] = (), up: str = "+Y", kind: str = "glb") -> bytes:
    """A file of some parts that stand on +Z here, with another axis up."""
    turn = {"+Y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]], "+Z": np.eye(3), "+X": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]}[up]
    scene = trimesh.Scene()
    for number, part in enumerate(parts):
        own = part.copy()
        own.vertices = own.vertices @ np.array(turn).T
        scene.add_geometry(own, node_name=names[number] if names else f"Object_{number}")
    content = scene.export(file_type=kind)
    return content.encode() if isinstance(content, str) else content


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(size).apply_translation(at)


def rod(start: tuple[float, float, float], end: tuple[float, float, float], radius: float) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, segment=[start, end], sections=12)


def potted() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """A plant of curved stems, and the pot that it stands in."""
    plant = grown("sapling").copy()
    plant.apply_scale(1.2 / plant.extents[2]).apply_translation((0, 0, -0.05))
    outline = (0, -0.3), (0.14, -0.3), (0.2, 0.0), (0.18, 0.0), (0.17, -0.03), (0, -0.03)
    return plant, trimesh.creation.revolve(np.array(outline))


def log(*, branches: bool = True) -> trimesh.Trimesh:
    """A felled trunk that lies along x, with stubs, thicker at one end."""
    angle, along = 2 * np.pi * np.arange(16) / 16, np.linspace(0, 4, 30)
    radius = (0.35 - 0.04 * along)[:, None]
    rings = np.stack([np.tile(along[:, None], 16), radius * np.cos(angle), 0.35 + radius * np.sin(angle)], 2)
    i, j = np.divmod(np.arange(29 * 16), 16)
    a, b = 16 * i + j, 16 * i + (j + 1) % 16
    sides = np.concatenate([np.c_[a, b, b + 16], np.c_[a, b + 16, a + 16]])
    trunk = trimesh.Trimesh(rings.reshape(-1, 3), sides, process=False)
    stubs = [rod((x, 0, 0.4), (x + 0.3, y, 0.8), 0.05) for x, y in ((1.2, 0.5), (2.4, -0.4), (3.1, 0.3))]
    return trimesh.util.concatenate([trunk, *stubs]) if branches else trunk


def low_poly() -> trimesh.Trimesh:
    """A pole and three balls of few faces, as of games."""
    balls = ((1.3, (0.8, 0, 2.6)), (1.2, (-0.8, 0.4, 2.9)), (1.0, (0.1, -0.6, 3.6)))
    crown = [trimesh.creation.icosphere(1, radius).apply_translation(at) for radius, at in balls]
    return trimesh.util.concatenate([rod((0, 0, 0), (0, 0, 2), 0.3), *crown])


def stump() -> trimesh.Trimesh:
    """The foot of a felled trunk with four roots."""
    roots = [rod((0, 0, 0.15), (1.1 * np.cos(t), 1.1 * np.sin(t), 0.05), 0.1) for t in 0.3 + np.pi / 2 * np.arange(4)]
    body = trimesh.creation.revolve(np.array([(0.0, 0.0), (0.55, 0.0), (0.42, 0.2), (0.4, 0.5), (0.0, 0.5)]))
    return trimesh.util.concatenate([body, *roots])


def robot() -> trimesh.Trimesh:
    """Rounded limbs around a trunk of boxes."""
    parts = [box((0.5, 0.3, 0.7), (0, 0, 1.05)), trimesh.creation.icosphere(3, 0.2).apply_translation((0, 0, 1.65))]
    parts += [trimesh.creation.capsule(0.5, 0.09).apply_translation((x, 0, 0.1)) for x in (-0.15, 0.15)]
    parts += [trimesh.creation.capsule(0.6, 0.07).apply_translation((x, 0, 0.7)) for x in (-0.36, 0.36)]
    return trimesh.util.concatenate(parts).apply_translation((0, 0, 0.24))


def splats(mesh: trimesh.Trimesh, color: tuple[float, float, float], count: int = 30_000) -> GaussianCloud:
    """Flat Gaussians of one colour over a surface."""
    surface = TriangleMesh(vertices=np.float32(mesh.vertices), faces=np.int32(mesh.faces))
    cloud = splats_of_mesh(surface, per_face=1, at_least=count, rng=np.random.default_rng(0)).cloud
    cloud = cloud.subset(np.random.default_rng(1).permutation(cloud.num_gaussians)[:count])
    noise = np.random.default_rng(2).normal(scale=0.03, size=(cloud.num_gaussians, 1, 3))
    return replace(cloud, sh=((np.array(color) + noise - 0.5) / 0.2820948).astype(np.float32))


def lawn(radius: float) -> trimesh.Trimesh:
    """A rough disc of small faces."""
    rng = np.random.default_rng(3)
    disc = trimesh.creation.annulus(0.001, radius, 1e-4, sections=64)
    points = trimesh.sample.sample_surface(disc, 6000, seed=4)[0]
    points[:, 2] = rng.normal(scale=0.01, size=len(points))
    blades = points[:, None] + rng.normal(scale=0.02, size=(len(points), 3, 3)) * [1, 1, 0.4]
    return trimesh.Trimesh(blades.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3), process=False)


def splat_bytes(*clouds: GaussianCloud) -> bytes:
    """A PLY that names neither axis nor unit, in the axes of a camera that looked level."""
    content = written(write_gaussian_ply, replace(join_clouds(clouds), source=Source(up_axis="-Y")))
    head, body = content.split(b"end_header\n", 1)
    lines = [line for line in head.split(b"\n") if not line.startswith(b"comment")]
    return b"\n".join(lines) + b"end_header\n" + body


def under_a_dome() -> bytes:
    tree = grown("round-broadleaf")
    dome = trimesh.creation.icosphere(4, 60.0)
    dome = trimesh.Trimesh(dome.vertices, dome.faces[dome.triangles_center[:, 2] > -1])
    sky = splats(dome, (0.6, 0.8, 1.0), 12_000)
    return splat_bytes(splats(tree, (0.2, 0.5, 0.15), 60_000), splats(lawn(12.0), (0.3, 0.5, 0.2)), sky)


def robot_on_a_lawn() -> bytes:
    return splat_bytes(splats(robot(), (0.55, 0.55, 0.6), 60_000), splats(lawn(3.0), (0.3, 0.55, 0.2)))


def photogrammetry() -> bytes:
    """As COLMAP writes its fused points: in arbitrary units, -Y up, with normals and colours."""
    mesh = grown("round-broadleaf")
    points, face = trimesh.sample.sample_surface(mesh, 20_000, seed=0)
    rows = np.zeros(len(points), [("place", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 3)])
    down = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    rows["place"], rows["normal"], rows["color"] = points @ down.T, mesh.face_normals[face] @ down.T, (60, 120, 40)
    names = [*(f"float {n}" for n in ("x", "y", "z", "nx", "ny", "nz")), "uchar red", "uchar green", "uchar blue"]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *(f"property {n}" for n in names)]
    return ("\n".join([*head, "end_header"]) + "\n").encode() + rows.tobytes()


def stand() -> bytes:
    species = enumerate(("birch", "maple", "pine"))
    return exported(*(grown(name, 3).copy().apply_translation((4.0 * n, 0, 0)) for n, name in species))


def firs() -> bytes:
    """Two cones on stems that grow into one another, so that the lower one has no top of its own, and one apart."""
    trees = ((0.0, 7.5), (2.0, 6.0), (9.0, 7.0))
    cones = [trimesh.creation.cone(1.5, tall - 2).apply_translation((x, 0, 2)) for x, tall in trees]
    return exported(trimesh.util.concatenate([*cones, *(rod((x, 0, 0), (x, 0, 3), 0.4) for x, _ in trees)]))


def ferns(count: int, width: float, apart: float) -> bytes:
    """A row of plants of five leaves, which rise to 0.5 m and droop: the tips hang as low as plants would stand."""
    leaves = []
    for way in np.exp(2j * np.pi * np.arange(5) / 5) * width / 2:
        top, tip = (0.6 * way.real, 0.6 * way.imag, 0.5), (way.real, way.imag, 0.2)
        leaves += [rod((0, 0, 0), top, 0.02), rod(top, tip, 0.02)]
    one = trimesh.util.concatenate(leaves)
    row = [one.copy().apply_translation((x, 0, 0)) for x in apart * np.arange(count)]
    return exported(trimesh.util.concatenate(row))


def trellis() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """A climber before a lattice of slats, as one part without a name."""
    upright = [box((0.05, 0.03, 2.0), (x, 0.3, 1.0)) for x in np.linspace(-0.8, 0.8, 6)]
    across = [box((1.65, 0.03, 0.05), (0, 0.33, z)) for z in np.linspace(0.2, 1.9, 6)]
    climber = grown("sapling").copy()
    climber.apply_scale(1.8 / climber.extents[2])
    return climber, trimesh.util.concatenate([*upright, *across])


def on_a_table() -> tuple[trimesh.Trimesh, ...]:
    """A plant in a pot on a table with four legs: three nodes without names."""
    plant, pot = potted()
    legs = [box((0.06, 0.06, 0.7), (x, y, -0.7)) for x in (-0.5, 0.5) for y in (-0.35, 0.35)]
    return plant, pot, trimesh.util.concatenate([box((1.2, 0.9, 0.05), (0, 0, -0.325)), *legs])


def on_a_stool() -> tuple[trimesh.Trimesh, ...]:
    """A plant in a pot on a round stool with three legs that stand aslant: no two boxes or rods along one axis."""
    plant, pot = potted()
    way = [(np.cos(angle), np.sin(angle)) for angle in (0, 2.1, 4.2)]
    legs = [rod((0.2 * x, 0.2 * y, -0.35), (0.25 * x, 0.25 * y, -1.0), 0.02) for x, y in way]
    seat = trimesh.creation.cylinder(0.3, 0.05).apply_translation((0, 0, -0.35))
    return plant, pot, trimesh.util.concatenate([seat, *legs])


def shrunk(species: str) -> trimesh.Trimesh:
    """In a cube of side 1, as AI tools give meshes."""
    mesh = grown(species).copy()
    return mesh.apply_scale(1 / mesh.extents.max())


def is_one(stated: Verdict) -> bool:
    return bool(stated["trees"] == 1 and "several-trees" not in stated["warnings"])


def is_calm(stated: Verdict) -> bool:
    return stated["warnings"] == []


def holds(count: int) -> Callable[[Verdict], bool]:
    return lambda stated: (stated["trees"], stated["warnings"]) == (count, ["several-trees"])


def warns(code: str) -> Callable[[Verdict], bool]:
    return lambda stated: code in stated["warnings"]


def stands(parts: Callable[[], tuple[trimesh.Trimesh, ...]]) -> Callable[[Verdict], bool]:
    """All parts but the first stand still, and nothing else."""
    return lambda stated: stated["still"] == sum(len(part.faces) for part in parts()[1:])


def scene(parts: Callable[[], tuple[trimesh.Trimesh, ...]], *names: str) -> Kind:
    """A plant, and parts that stand still."""
    return Kind(lambda: exported(*parts(), names=names), stands(parts))


def lying(mesh: Callable[[], trimesh.Trimesh], up: str, file_type: str) -> Kind:
    """What looks as if it lay, where it stands along the file's `up`."""
    doubted = warns("orientation-uncertain")
    return Kind(
        lambda: exported(mesh(), up=up, kind=file_type), lambda stated: stated["up"] == up or doubted(stated), file_type
    )


def on_a_disc() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    return grown("maple"), trimesh.creation.cylinder(3, 0.1).apply_translation((0, 0, -0.05))


def of_30_m() -> bytes:
    return exported(grown("shrub").copy().apply_scale(30 / grown("shrub").extents[2]))


def is_doubted_in_size_and_axis(stated: Verdict) -> bool:
    upright = stated["up"] == "-Y" or "orientation-uncertain" in stated["warnings"]
    return upright and "size-unknown" in stated["warnings"]


KINDS = {
    "willow": Kind(lambda: exported(grown("weeping", 1, base_size=0.08)), lambda own: is_one(own) and not own["still"]),
    "willow to the ground": Kind(lambda: exported(grown("weeping", base_size=0.03)), is_one),
    "beech": Kind(lambda: exported(grown("spreading-broadleaf", hang=1.0)), is_one),
    "bush": Kind(lambda: exported(grown("shrub", hang=1.0)), is_one),
    "three trees": Kind(stand, holds(3)),
    "firs that meet, and one apart": Kind(firs, holds(2)),
    "row of tufts": Kind(partial(ferns, 12, 0.5, 0.6), holds(12)),
    "row of ferns": Kind(partial(ferns, 4, 0.9, 1.5), holds(4)),
    "plant named NurbsPath": scene(potted, "NurbsPath", "Cylinder.001"),
    "plant named Path in a Planter": scene(potted, "Path.003", "Planter"),
    "log": lying(log, "+Y", "obj"),
    "bare log": lying(partial(log, branches=False), "+Z", "stl"),
    "stump": lying(stump, "+Y", "obj"),
    "tree along +Z in a GLB": Kind(lambda: exported(grown("round-broadleaf"), up="+Z"), warns("orientation-uncertain")),
    "low-poly tree along +Z in a GLB": Kind(lambda: exported(low_poly(), up="+Z"), warns("orientation-uncertain")),
    "low-poly tree along +Y in a GLB": Kind(lambda: exported(low_poly()), is_calm),
    "tree along +Y in a GLB": Kind(lambda: exported(grown("round-broadleaf")), is_calm),
    "fused points of photos": Kind(photogrammetry, is_doubted_in_size_and_axis, "ply"),
    "splat under a sky": Kind(
        under_a_dome, lambda stated: 4.5 < stated["moving_height_m"] < 5.6 and stated["still"] > 30_000, "ply"
    ),
    "robot on a lawn": Kind(
        robot_on_a_lawn, lambda stated: warns("not-like-a-plant")(stated) and stated["still"] > 20_000, "ply"
    ),
    "mesh in a unit cube": Kind(lambda: exported(shrunk("maple"), kind="obj"), warns("size-doubtful"), "obj"),
    "bush of 30 m": Kind(of_30_m, warns("size-doubtful")),
    "trellis": scene(trellis),
    "pot on a table": scene(on_a_table),
    "pot on a stool": scene(on_a_stool),
    "ground disc": scene(on_a_disc),
}
