"""`dynamictree voxelize`: convert a shape to its occupied voxels."""

from dynamictree import method
from dynamictree.commands.input_files import file_sha256, read_source
from dynamictree.commands.options import OutputFile, SourcePath
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, show_result
from dynamictree.files import atomic_folder
from dynamictree.formats.tensors.voxels import write_voxels
from dynamictree.requests import CloudParams, GridParams, Reading


@with_request_options
def voxelize(
    source: SourcePath,
    output: OutputFile,
    cloud: CloudParams,
    grid: GridParams,
    reading: Reading,
    as_json: AsJson = False,
) -> None:
    """Write the voxels that the tree's surface occupies (*.voxels.safetensors)."""
    mesh, _ = read_source(source, reading, choice=cloud)
    voxels = method.voxelize(mesh, resolution=grid.resolution, source_sha256=file_sha256(source))
    with atomic_folder(output.parent) as folder, (folder / output.name).open("wb") as stream:
        write_voxels(voxels, stream)
    show_result(
        {"file": str(output), "num_voxels": len(voxels.grid), "voxel_size_m": voxels.grid.voxel_size_m}, as_json=as_json
    )
