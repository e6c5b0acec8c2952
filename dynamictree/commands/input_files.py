"""Read the input shape of a command: a mesh, or a splat or scan with the mesh that carries it."""

import hashlib
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import typer

from dynamictree.errors import InputError
from dynamictree.files import open_input
from dynamictree.formats.companions import Companions
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.formats.source_file import read_capture, source_kind
from dynamictree.formats.tensors.container import tensor_format
from dynamictree.mesh import SourceWarning, TriangleMesh
from dynamictree.plant.capture import Capture, carrying_mesh, only_tree
from dynamictree.plant.choice import with_choice
from dynamictree.plant.trees.of_mesh import only_tree_of
from dynamictree.requests import CloudParams, Reading
from dynamictree.spectrum import SparseVoxelSpectrum


def is_tensor_file(path: Path, file_format: str, ending: str) -> bool:
    """Whether a file has one of the project's own tensor formats, by its metadata or its name.

    Raises:
        InputError: it cannot be read.
    """
    with open_input(path) as stream:
        return path.name.endswith(ending) or tensor_format(stream) == file_format


def is_cloud(path: Path) -> bool:
    """Whether a file holds a splat or scan, by its bytes.

    Raises:
        InputError: it cannot be read, or its format is unknown.
    """
    with open_input(path) as stream:
        return source_kind(stream, path.name)[0] == "cloud"


def read_source(
    path: Path,
    reading: Reading,
    *,
    choice: CloudParams | None = None,
    mask: Path | None = None,
    beside: Path | None = None,
) -> tuple[TriangleMesh, Capture | None]:
    """Read a mesh; or read a splat or scan, and return it with the mesh that carries its moving part.

    Raises:
        InputError: a file cannot be read, or they do not fit together.
    """
    number = None if choice is None else choice.tree
    if not is_cloud(path):
        if mask is not None or beside is not None:
            raise InputError(f"{path} is a mesh; --mask and --mesh are for splats and scans")
        mesh = with_choice(load_mesh(path, reading), choice or CloudParams())
        print_how_read(mesh, mesh.warnings)
        return mesh if number is None else only_tree_of(mesh, number), None
    capture = load_capture(path, reading, mask=mask, mesh=beside)
    if number is not None:
        capture = only_tree(capture, number)
    mesh = carrying_mesh(capture, choice)
    print_how_read(mesh, capture.warnings)
    return mesh, capture


def print_how_read(mesh: TriangleMesh, warnings: Sequence[SourceWarning]) -> None:
    """Print height, axis and unit as they were read, and the reader's warnings, to standard error."""
    unit = f"unit {mesh.source.scale:g} m"
    typer.echo(f"read as {mesh.height_text} tall, {mesh.source.up_axis} up, {unit}", err=True)
    for warning in warnings:
        typer.echo(f"warning: {warning.message} ({warning.code})", err=True)


def warn_of_unknown_foliage(spectrum: SparseVoxelSpectrum) -> None:
    """Warn on standard error if the shape does not show whether the tree is in leaf."""
    if spectrum.foliage is None:
        typer.echo(
            "warning: the shape does not tell whether the tree is bare or in leaf: it is damped in between; "
            "say it with --foliage, 0 to 1 (foliage-unknown)",
            err=True,
        )


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes.

    Raises:
        InputError: it cannot be read.
    """
    with open_input(path) as stream:
        digest = hashlib.sha256()
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def load_mesh(path: Path, reading: Reading | None = None) -> TriangleMesh:
    """Read a mesh file, and the files beside it that it names (MTL, textures), in metres and +Z up.

    Raises:
        InputError: it cannot be read, or the method cannot use the mesh.
    """
    with open_input(path) as stream:
        file_type = sniff_file_type(stream.read(4096), path.name)
        stream.seek(0)
        return read_mesh(stream, file_type=file_type, reading=reading, companions=Companions(path))


def load_capture(
    path: Path, reading: Reading | None = None, *, mask: Path | None = None, mesh: Path | None = None
) -> Capture:
    """Read a splat or scan, a mask of what may move, and a mesh in the same place.

    Raises:
        InputError: one of them cannot be read, or they do not fit together.
    """
    with ExitStack() as stack:
        stream = stack.enter_context(open_input(path))
        _, file_type = source_kind(stream, path.name)
        return read_capture(
            stream,
            file_type=file_type,
            reading=reading,
            mask=None if mask is None else stack.enter_context(open_input(mask)),
            mesh=None if mesh is None else (mesh.name, stack.enter_context(open_input(mesh))),
            companions=Companions(mesh or path),
        )
