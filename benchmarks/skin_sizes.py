"""Size and errors of a moving tree as GLB: joints for all bones, for 256 or 64 of them, or morph targets.

Ten inputs: eight third-party meshes and two generated trees, with the default model and wind. The source size includes
textures; for a generated tree it is its GLB at rest. Errors are those stated in the files [height / 1000].
"""

import io
import tempfile
from pathlib import Path

from benchmarks._machine import machine
from benchmarks.golden_motion import MESHES as GOLDEN_MESHES
from benchmarks.golden_motion import SAMPLES
from dynamictree import method
from dynamictree.commands.input_files import load_mesh
from dynamictree.export.write import write_products
from dynamictree.formats.gltf.writer import write_glb
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import ExportParams, Reading
from lab.dataset.sample import make_sample

MESHES = (*GOLDEN_MESHES, "../foreign/mesh/bevy_palm_scene/PalmTree.gltf", "../foreign/mesh/godot_tree/scene.gltf")
GENERATED = ((7, "round-broadleaf"), (6, "conical-conifer"))


def run() -> dict[str, object]:
    rows: dict[str, dict[str, object]] = {}
    for path in (SAMPLES / name for name in MESHES):
        if path.exists():
            files = [path] if path.suffix in (".glb", ".ply") else [f for f in path.parent.rglob("*") if f.is_file()]
            rows[path.name] = _sizes(load_mesh(path, Reading()), sum(file.stat().st_size for file in files))
    for seed, species in GENERATED:
        mesh, source = make_sample(seed, species).mesh, io.BytesIO()
        write_glb(mesh, source)
        rows[species] = _sizes(mesh, len(source.getvalue()))
    return {
        "value": max(float(str(row["all_over_wanted"])) for row in rows.values()),
        "unit": "bytes of a skin of all bones over 1.3 times the source and 3 MB",
        "target": 1.0,
        "inputs": rows,
        **machine("numpy", "torch"),
    }


def _sizes(mesh: TriangleMesh, source_bytes: int) -> dict[str, object]:
    spectrum = method.generate(method.voxelize(mesh), seed=0)
    row: dict[str, object] = {"source_mb": round(source_bytes / 1e6, 2), "vertices": mesh.num_vertices}
    with tempfile.TemporaryDirectory() as folder:
        for name, joints in (("morph", 0), ("all", None), ("256", 256), ("64", 64)):
            product = "glb-morph" if name == "morph" else "glb"
            facts: dict[str, dict[str, int | float]] = {}
            options = ExportParams(formats=(product,), joints=joints or None)
            path = write_products(mesh, spectrum, options, Path(folder), on_facts=facts.__setitem__)[product]
            size = path.stat().st_size
            row[f"{name}_mb"] = round(size / 1e6, 2)
            row[f"{name}_max_error"] = round(1e3 * facts[product]["max_error_m"] / mesh.height_m, 3)
            if name == "all":
                row["bones"] = facts[product]["num_joints"]
                row["all_over_wanted"] = round(size / (1.3 * source_bytes + 3e6), 2)
    return row
