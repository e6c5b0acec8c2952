"""Number of trees set upright from six axes: 14 species, the files of DYNAMICTREE_SAMPLES and `foreign` beside it.

Each is rotated into six orientations, and its up axis is detected; meshes of files with and without the names of their
materials. Wrong answers below the reader's threshold are `flagged`, the others `unsaid`.

    python -m benchmarks upright_trees
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks._machine import machine
from dynamictree.axis_names import AXES
from dynamictree.commands.input_files import load_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.upright import CERTAIN, judge_up_axis
from dynamictree.requests import Reading
from dynamictree.up_axis import up_rotation
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES

SEEDS = (11, 12, 13)
TARGET = 0.98
FILES: dict[str, Reading | None] = {
    "data/mesh/tree-lime.glb": None,
    "data/mesh/quaternius_common_tree/CommonTree_2.obj": None,
    "foreign/mesh/maple_pack_obj/tree.obj": Reading(up_axis="+Y"),
    "foreign/mesh/godot_tree/scene.gltf": None,
    "foreign/mesh/bevy_palm_scene/PalmTree.gltf": None,
    "foreign/mesh/pcu_tree.ply": Reading(up_axis="+Z"),
}


def run() -> dict[str, object]:
    rows: dict[str, dict[str, int]] = {}
    for name, mesh in _upright():
        row = rows.setdefault(name, {"right": 0, "flagged": 0, "unsaid": 0})
        for axis in AXES:
            judged = judge_up_axis(mesh.with_vertices((mesh.vertices @ up_rotation(axis)).astype(np.float32)))
            row["right" if judged.axis == axis else "flagged" if judged.confidence < CERTAIN else "unsaid"] += 1
    right, total = sum(row["right"] for row in rows.values()), sum(sum(row.values()) for row in rows.values())
    return {
        "value": round(right / total, 4),
        "unit": "share of readings that stand up",
        "target": TARGET,
        "unsaid": sum(row["unsaid"] for row in rows.values()),
        "readings": total,
        "trees": rows,
        **machine("numpy"),
    }


def _upright() -> Iterator[tuple[str, TriangleMesh]]:
    for name, species in SPECIES.items():
        for seed in SEEDS:
            yield name, _nameless(grow_tree(species, np.random.default_rng([seed, len(name)])).mesh)
    samples = os.environ.get("DYNAMICTREE_SAMPLES")
    if not samples:
        return
    for path in sorted((Path(samples) / "sapling").glob("*.npz")):
        stored = np.load(path)
        yield (
            path.stem,
            TriangleMesh(vertices=stored["rest"].astype(np.float32), faces=stored["faces"].astype(np.int32)),
        )
    for name, reading in FILES.items():
        path = Path(samples).parent / name
        if path.exists():
            mesh = load_mesh(path, reading)
            yield path.name, mesh
            yield f"{path.name}, no names", _nameless(mesh)


def _nameless(mesh: TriangleMesh) -> TriangleMesh:
    return replace(
        mesh,
        look=replace(mesh.look, materials=(), face_material=None),
        parts=replace(mesh.parts, names=(), of_face=None),
    )
