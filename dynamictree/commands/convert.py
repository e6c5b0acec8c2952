"""`dynamictree convert`: convert a mesh, splat or scan to another file format."""

from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.input_files import is_cloud, load_capture, load_mesh, print_how_read
from dynamictree.commands.options import SourcePath
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, show_result
from dynamictree.errors import InputError
from dynamictree.files import atomic_folder
from dynamictree.formats.gltf.gaussian import write_gltf_gaussian
from dynamictree.formats.gltf.template import open_document
from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.formats.splat.sog import write_sog
from dynamictree.formats.splat.splat import write_splat
from dynamictree.formats.splat.spz import write_spz
from dynamictree.mesh import TriangleMesh
from dynamictree.requests import Reading

CLOUD_WRITERS = {
    ".ply": write_gaussian_ply,
    ".splat": write_splat,
    ".spz": write_spz,
    ".sog": write_sog,
    ".glb": write_gltf_gaussian,
}
MESH_ENDINGS = (".glb", ".obj", ".ply")


@with_request_options
def convert(
    source: SourcePath,
    output: Annotated[
        Path,
        typer.Argument(
            dir_okay=False, help="File to write. Meshes: .glb, .obj, .ply. Clouds: .ply, .splat, .spz, .sog, .glb."
        ),
    ],
    reading: Reading,
    as_json: AsJson = False,
) -> None:
    """Convert a mesh, splat or scan to the format of OUTPUT's ending.

    Meshes are written in metres; OBJ and PLY with +Z up. A glTF keeps all of its content as GLB. Splats keep
    the axes and units of their file; SPZ and GLB are +Y up, SOG is -Y up.
    """
    cloud = load_capture(source, reading).cloud if is_cloud(source) else None
    mesh = load_mesh(source, reading) if cloud is None else None
    endings = tuple(CLOUD_WRITERS) if mesh is None else MESH_ENDINGS
    if output.suffix.lower() not in endings:
        kind = "splat or scan" if mesh is None else "mesh"
        raise InputError(f"{output.name!r} is no file that a {kind} is written to; choose from {', '.join(endings)}")
    with atomic_folder(output.parent) as folder:
        if mesh is not None:
            print_how_read(mesh, mesh.warnings)
            _write_mesh(mesh, folder / output.name)
        elif cloud is not None:
            with (folder / output.name).open("wb") as stream:
                CLOUD_WRITERS[output.suffix.lower()](cloud, stream)
        num_bytes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    show_result({str(output.parent / name): f"{size:,} bytes" for name, size in num_bytes.items()}, as_json=as_json)


def _write_mesh(mesh: TriangleMesh, path: Path) -> None:
    """Write a mesh in the format of the path's ending; an OBJ with its MTL and textures beside it."""
    with path.open("wb") as stream:
        match path.suffix.lower():
            case ".glb":
                open_document(mesh).finish(stream)
            case ".ply":
                write_ply(mesh, stream)
            case _:
                library = f"{path.stem}.mtl" if mesh.look.materials else ""
                for name, content in write_obj(mesh, stream, library=library).items():
                    (path.parent / name).write_bytes(content)
