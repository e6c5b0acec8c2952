"""Verdicts on every sample file: up axis, size, still faces or points, number of trees, warnings.

Files of DYNAMICTREE_SAMPLES, of `foreign` and `cases` beside it and of the page, and generated ones with a known right
answer (`KINDS`). Two tables, before and after a change of the detectors, show what became better or worse.

    python -m benchmarks plant_verdicts
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks._machine import machine
from tests.plant.kinds import KINDS, verdict

ENDINGS = (
    *(".glb", ".gltf", ".obj", ".ply", ".stl", ".off", ".dae", ".3mf"),
    *(".splat", ".spz", ".ksplat", ".sog", ".las", ".laz", ".txt", ".xyz", ".asc", ".pts", ".pcd", ".csv"),
)
NO_TREES = ("license.txt", "Apache-2.0.txt")
PAGE = Path(__file__).parents[1] / "web/examples"


def run() -> dict[str, object]:
    files = {str(path.relative_to(root.parent)): verdict(path) for root in _roots() for path in _files(root)}
    kinds = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, kind in KINDS.items():
            path = Path(folder) / f"{name.replace(' ', '_')}.{kind.file_type}"
            path.write_bytes(kind.content())
            stated = verdict(path)
            kinds[name] = {"right": kind.is_right(stated)} | stated
    return {
        "value": round(sum(bool(kind["right"]) for kind in kinds.values()) / len(kinds), 3),
        "unit": "share of made inputs whose verdict is right",
        "target": 1.0,
        "kinds": kinds,
        "files": files,
        **machine("numpy", "scipy"),
    }


def _roots() -> Iterator[Path]:
    samples = os.environ.get("DYNAMICTREE_SAMPLES")
    if samples:
        yield from (Path(samples), Path(samples).parent / "foreign", Path(samples).parent / "cases")
    yield PAGE


def _files(root: Path) -> Iterator[Path]:
    for path in sorted(root.rglob("*")):
        if path.suffix.lower() in ENDINGS and path.name not in NO_TREES and "licenses" not in path.parts:
            yield path
