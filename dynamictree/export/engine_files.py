"""Writers of the products that game engines load beside a plain animated mesh."""

import io
import json
from dataclasses import asdict
from typing import BinaryIO

from dynamictree.export.moving_tree import Facts, MovingTree, Report
from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.stored_zip import iter_stored_zip

COVERAGE = (0.5, 0.25, 0.1, 0.04, 0.0)
"""Share of the screen's height below which the next level is shown."""


def write_levels(tree: MovingTree, stream: BinaryIO, report: Report) -> Facts:
    """Four levels of detail and cards: all in one GLB with MSFT_lod, one GLB each, and their errors as JSON."""
    from dynamictree.export.levels import levels_of
    from dynamictree.formats.gltf.lod import write_lod_glb

    num_frames = tree.spectrum.num_frames
    levels = levels_of(tree.mesh, tree.coefficients, num_frames)
    errors = [asdict(level.error) | {"coverage": share} for level, share in zip(levels, COVERAGE, strict=True)]
    together = io.BytesIO()
    write_lod_glb(
        [(level.mesh, level.coefficients) for level in levels],
        together,
        coverage=COVERAGE,
        num_frames=num_frames,
        fps=tree.loop_fps,
        extras={"levels": errors},
    )
    files = [("lod.json", json.dumps({"levels": errors}, indent=1).encode()), ("tree-lod.glb", together.getvalue())]
    for number, level in enumerate(levels):
        report(number / len(levels))
        single = io.BytesIO()
        write_motion_glb(level.mesh, level.coefficients, single, num_frames=num_frames, fps=tree.loop_fps)
        files.append((f"tree-lod{number}.glb", single.getvalue()))
    stream.writelines(iter_stored_zip((name, [content]) for name, content in files))
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
