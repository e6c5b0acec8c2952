"""`dynamictree animate`: a shape to files that show its motion."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynamictree.commands.options import OutputFolder, SourcePath
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.source import read_source
from dynamictree.files import published
from dynamictree.requests import CloudParams, ExportParams, GeneratorGridParams, ModelParams, Reading, SpectrumParams
from dynamictree.terminal import AsJson, progress, tell

if TYPE_CHECKING:
    from dynamictree.gaussian.capture import Capture
    from dynamictree.products import Facts


@with_request_options
def animate(
    source: SourcePath,
    output: OutputFolder,
    export: ExportParams,
    cloud: CloudParams,
    grid: GeneratorGridParams,
    model: ModelParams,
    generation: SpectrumParams,
    reading: Reading,
    mask: Annotated[
        Path | None,
        typer.Option(help="Of a splat or scan: .npy with one bool per Gaussian, true where it may move."),
    ] = None,
    mesh: Annotated[
        Path | None, typer.Option("--mesh", help="Of a splat or scan: a mesh in the same place that carries it.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Make a tree sway: mesh or splat → voxels → spectrum → motion files."""
    from dynamictree import pipeline
    from dynamictree.formats.tensors.spectrum import write_spectrum
    from dynamictree.products import FILE_NAMES

    shape, capture = read_source(source, reading, box_m=cloud.box_m, mask=mask, beside=mesh)
    if capture is not None and not as_json:
        _print_sequence_size(capture, export)
    inexact: dict[str, Facts] = {}
    with progress(quiet=as_json) as report, published(output) as folder:
        voxels = pipeline.voxelize(shape, resolution=grid.resolution)
        report("voxelize", 1.0)
        spectrum = pipeline.diffuse(
            voxels,
            preset=model.preset,
            seed=model.seed,
            wind=generation.wind,
            num_steps=generation.num_steps,
            on_step=lambda done, total: report("diffuse", done / total),
        )
        with (folder / "tree.spectrum.safetensors").open("wb") as stream:
            write_spectrum(spectrum, stream)
        pipeline.animate(
            shape,
            spectrum,
            export,
            folder,
            lambda done: report("animate", done),
            capture=capture,
            box_m=cloud.box_m,
            on_facts=lambda name, facts: inexact.update({FILE_NAMES[name]: facts}),
        )
        names = sorted(path.name for path in folder.iterdir())
    result: dict[str, Any] = {"files": [str(output / name) for name in names], "num_voxels": len(spectrum.grid)}
    if inexact:
        result["inexact"] = inexact if as_json else [_error_line(name, facts) for name, facts in inexact.items()]
    tell(result, as_json=as_json)


def _print_sequence_size(capture: "Capture", export: ExportParams) -> None:
    """Print how large a sequence of splats will be, before it is written."""
    from dynamictree.spectrum import FPS, NUM_FRAMES
    from dynamictree.splat_products import describe_sequence

    if "splat-ply" in (export.formats or ()):
        size = describe_sequence(capture.cloud, export.count_frames(NUM_FRAMES / FPS), export)
        typer.echo(f"splat-ply: {size}", err=True)


def _error_line(name: str, facts: "Facts") -> str:
    return (
        f"{name} is off by {1e3 * facts['rms_error_m']:.3g} mm rms ({facts['relative_error']:.2%} of the motion), "
        f"{1e3 * facts['max_error_m']:.3g} mm at most"
    )
