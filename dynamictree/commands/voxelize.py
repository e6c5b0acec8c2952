"""`dynamictree voxelize`: a shape to its voxels."""

from dynamictree.commands.options import BoxCorners, OutputFile, Resolution, SourcePath, UnitM, UpAxis, box_of
from dynamictree.commands.source import read_source
from dynamictree.files import published
from dynamictree.terminal import AsJson, tell


def voxelize(
    source: SourcePath,
    output: OutputFile,
    box: BoxCorners = None,
    resolution: Resolution = 128,
    up_axis: UpAxis = None,
    unit_m: UnitM = None,
    as_json: AsJson = False,
) -> None:
    """Write the voxels that hold a piece of the tree's surface (*.voxels.safetensors)."""
    from dynamictree import pipeline
    from dynamictree.formats.tensors.voxels import write_voxels

    mesh, _ = read_source(source, up_axis=up_axis, unit_m=unit_m, box_m=box_of(box))
    voxels = pipeline.voxelize(mesh, resolution=resolution)
    with published(output.parent) as folder, (folder / output.name).open("wb") as stream:
        write_voxels(voxels, stream)
    tell(
        {"file": str(output), "num_voxels": len(voxels.grid), "voxel_size_m": voxels.grid.voxel_size_m}, as_json=as_json
    )
