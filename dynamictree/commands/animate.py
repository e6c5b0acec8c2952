"""`dynamictree animate`: generate a motion and write it as files."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dynamictree import method
from dynamictree.commands.input_files import file_sha256, read_source, warn_of_unknown_foliage
from dynamictree.commands.options import OutputFolder, SourcePath
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, progress, show_result
from dynamictree.export.moving_tree import Facts
from dynamictree.export.size import min_sequence_bytes
from dynamictree.export.table import PRODUCTS
from dynamictree.export.write import write_products
from dynamictree.files import atomic_folder
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.modal.real_trees import loop_period_s
from dynamictree.requests import CloudParams, ExportParams, GeneratorGridParams, ModelParams, Reading, SpectrumParams


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
        Path | None, typer.Option(help="For a splat or scan: .npy with one bool per Gaussian, true if it may move.")
    ] = None,
    mesh: Annotated[
        Path | None, typer.Option("--mesh", help="For a splat or scan: a mesh at the same place that moves it.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Generate the motion of a tree: mesh or splat → voxels → spectrum → motion files."""
    shape, capture = read_source(source, reading, choice=cloud, mask=mask, beside=mesh)
    period_s = generation.period_s or export.wanted_period_s
    if period_s is not None:
        export.count_frames(period_s)  # refuses what is no loop before the work
    if capture is not None and not as_json:
        _print_sequence_size(capture.cloud, export, period_s)
    inexact: dict[str, Facts] = {}
    with progress(quiet=as_json) as report, atomic_folder(output) as folder:
        voxels = method.voxelize(shape, resolution=grid.resolution, source_sha256=file_sha256(source))
        report("voxelize", 1.0)
        spectrum = method.generate(
            voxels,
            model=model.preset,
            seed=model.seed,
            of_cloud=capture is not None,
            on_step=lambda done, total: report("diffuse", done / total),
            **{**dict(generation), "period_s": period_s},
        )
        warn_of_unknown_foliage(spectrum)
        with (folder / "tree.spectrum.safetensors").open("wb") as stream:
            write_spectrum(spectrum, stream)
        write_products(
            shape,
            spectrum,
            export,
            folder,
            lambda done: report("animate", done),
            capture=capture,
            choice=cloud,
            on_facts=lambda name, facts: inexact.update({PRODUCTS[name].file_name: facts}),
        )
        names = sorted(path.name for path in folder.iterdir())
    result: dict[str, Any] = {"files": [str(output / name) for name in names], "num_voxels": len(spectrum.grid)}
    if inexact:
        lines = [
            f"{name} is off by {1e3 * facts['rms_error_m']:.3g} mm rms ({facts['relative_error']:.2%} of the motion), "
            f"{1e3 * facts['max_error_m']:.3g} mm at most"
            for name, facts in inexact.items()
        ]
        result["inexact"] = inexact if as_json else lines
    show_result(result, as_json=as_json)


def _print_sequence_size(cloud: GaussianCloud, export: ExportParams, period_s: float | None) -> None:
    """Print the size of files with every frame of a splat, before they are written."""
    z_m = cloud.means[:, 2]
    num_frames = export.count_frames(period_s or loop_period_s(float(z_m.max() - z_m.min())))
    splats = [name for name in export.formats or () if name in ("splat-ply", "usd-splat")]
    sizes = min_sequence_bytes(splats, num_frames, export, cloud=(cloud.num_gaussians, cloud.sh_degree))
    for name, size in sizes.items():
        typer.echo(f"{name}: {num_frames} frames: {size / 1e6:,.1f} MB", err=True)
