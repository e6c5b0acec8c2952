"""`dynamictree diffuse`: a shape to the spectrum of its motion."""

from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.options import (
    BoxCorners,
    Gust,
    NumSteps,
    OutputFile,
    Preset,
    Resolution,
    Seed,
    UnitM,
    UpAxis,
    WindDirection,
    WindSpeed,
    box_of,
)
from dynamictree.commands.source import is_tensor_file, read_source
from dynamictree.files import opened, published
from dynamictree.terminal import AsJson, progress, tell


def diffuse(
    source: Annotated[
        Path, typer.Argument(help="A mesh, a splat, a scan, or a *.voxels.safetensors that `voxelize` wrote.")
    ],
    output: OutputFile,
    box: BoxCorners = None,
    resolution: Resolution = 128,
    preset: Preset = "small",
    seed: Seed = 0,
    num_steps: NumSteps = None,
    wind_speed: WindSpeed = 5.0,
    wind_direction: WindDirection = 0.0,
    gust: Gust = 0.3,
    up_axis: UpAxis = None,
    unit_m: UnitM = None,
    as_json: AsJson = False,
) -> None:
    """Generate the spectrum of a tree's motion from its shape (*.spectrum.safetensors)."""
    from dynamictree import pipeline
    from dynamictree.formats.tensors.spectrum import write_spectrum
    from dynamictree.formats.tensors.voxels import FORMAT, read_voxels
    from dynamictree.spectrum import Wind

    if is_tensor_file(source, FORMAT, ".voxels.safetensors"):
        with opened(source) as stream:
            voxels = read_voxels(stream)
    else:
        mesh, _ = read_source(source, up_axis=up_axis, unit_m=unit_m, box_m=box_of(box))
        voxels = pipeline.voxelize(mesh, resolution=resolution)
    with progress(quiet=as_json) as report:
        spectrum = pipeline.diffuse(
            voxels,
            preset=preset,
            seed=seed,
            wind=Wind(speed_m_s=wind_speed, direction_deg=wind_direction, gust=gust),
            num_steps=num_steps,
            on_step=lambda done, total: report("diffuse", done / total),
        )
    with published(output.parent) as folder, (folder / output.name).open("wb") as stream:
        write_spectrum(spectrum, stream)
    tell({"file": str(output), "num_voxels": len(spectrum.grid), "period_s": spectrum.period_s}, as_json=as_json)
