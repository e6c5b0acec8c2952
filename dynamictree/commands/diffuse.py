"""`dynamictree diffuse`: generate the spectrum of a tree's motion."""

from pathlib import Path
from typing import Annotated

import typer

from dynamictree import method
from dynamictree.commands.input_files import file_sha256, is_tensor_file, read_source, warn_of_unknown_foliage
from dynamictree.commands.options import OutputFile, shape_file
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, progress, show_result
from dynamictree.files import atomic_folder, open_input
from dynamictree.formats.tensors.spectrum import write_spectrum
from dynamictree.formats.tensors.voxels import FORMAT, read_voxels
from dynamictree.requests import CloudParams, GeneratorGridParams, ModelParams, Reading, SpectrumParams


@with_request_options
def diffuse(
    source: Annotated[
        Path,
        typer.Argument(
            callback=shape_file, help="A mesh, a splat, a scan, or a *.voxels.safetensors that `voxelize` wrote."
        ),
    ],
    output: OutputFile,
    cloud: CloudParams,
    grid: GeneratorGridParams,
    model: ModelParams,
    params: SpectrumParams,
    reading: Reading,
    as_json: AsJson = False,
) -> None:
    """Generate the spectrum of a tree's motion from its shape (*.spectrum.safetensors)."""
    if is_tensor_file(source, FORMAT, ".voxels.safetensors"):
        capture = None
        with open_input(source) as stream:
            voxels = read_voxels(stream)
    else:
        mesh, capture = read_source(source, reading, choice=cloud)
        voxels = method.voxelize(mesh, resolution=grid.resolution, source_sha256=file_sha256(source))
    with progress(quiet=as_json) as report:
        spectrum = method.generate(
            voxels,
            model=model.preset,
            seed=model.seed,
            of_cloud=capture is not None,
            on_step=lambda done, total: report("diffuse", done / total),
            **dict(params),
        )
    warn_of_unknown_foliage(spectrum)
    with atomic_folder(output.parent) as folder, (folder / output.name).open("wb") as stream:
        write_spectrum(spectrum, stream)
    show_result({"file": str(output), "num_voxels": len(spectrum.grid), "period_s": spectrum.period_s}, as_json=as_json)
