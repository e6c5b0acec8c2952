"""`dynamictree info`: print what a file contains."""

from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.input_files import is_cloud, is_tensor_file, load_capture, load_mesh
from dynamictree.commands.options import shape_file
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, show_result
from dynamictree.files import open_input
from dynamictree.formats.description import describe_capture, describe_grid, describe_mesh, describe_spectrum
from dynamictree.formats.tensors import spectrum, voxels
from dynamictree.requests import Reading


@with_request_options
def info(
    source: Annotated[Path, typer.Argument(callback=shape_file, help="A mesh, splat, scan, voxel or spectrum file.")],
    reading: Reading,
    as_json: AsJson = False,
) -> None:
    """Print what a file contains."""
    if is_tensor_file(source, spectrum.FORMAT, ".spectrum.safetensors"):
        with open_input(source) as stream:
            facts = describe_spectrum(spectrum.read_spectrum(stream))
    elif is_tensor_file(source, voxels.FORMAT, ".voxels.safetensors"):
        with open_input(source) as stream:
            facts = describe_grid(voxels.read_voxels(stream).grid)
    elif is_cloud(source):
        facts = describe_capture(load_capture(source, reading))
    else:
        facts = describe_mesh(load_mesh(source, reading))
    if not as_json:
        facts["warnings"] = [f"{entry['message']} ({entry['code']})" for entry in facts.get("warnings", [])] or ["none"]
    show_result(facts, as_json=as_json)
