"""Arguments and options that several commands share, other than parameters of the method."""

from pathlib import Path
from typing import Annotated

import typer

from dynamictree.errors import InputError
from dynamictree.formats.companions import is_system_file
from dynamictree.formats.suffixes import CLOUD_SUFFIXES, MESH_SUFFIXES, PHOTO_SUFFIXES, POINT_SUFFIXES, SOG_FOLDER_FILE

_SHAPE_SUFFIXES = tuple(
    suffix for suffix in dict.fromkeys((*MESH_SUFFIXES, *CLOUD_SUFFIXES)) if suffix not in POINT_SUFFIXES
)


def shape_file(path: Path) -> Path:
    """Return the path; for a folder, the only file in it, or one level below, with the shape of a tree.

    Raises:
        InputError: a folder has no such file, or several.
    """
    most_names = 10  # names per message
    if not path.is_dir():
        return path
    entries = sorted(entry for pattern in ("*", "*/*") for entry in path.glob(pattern) if entry.is_file())
    entries = [entry for entry in entries if not is_system_file(entry.relative_to(path).as_posix())]
    shapes = [entry for entry in entries if entry.suffix.lower() in _SHAPE_SUFFIXES or entry.name == SOG_FOLDER_FILE]
    shapes = [entry for entry in shapes if entry.parent == path] or shapes
    shapes = shapes or [entry for entry in entries if entry.suffix.lower() in POINT_SUFFIXES]
    if len(shapes) == 1:
        return shapes[0]
    if shapes:
        names = ", ".join(str(one.relative_to(path)) for one in shapes[:most_names])
        raise InputError(f"{path} holds {len(shapes)} shapes: {names}; name one of them")
    if any(entry.suffix.lower() in PHOTO_SUFFIXES for entry in entries):
        raise InputError(f"{path} is a folder of pictures; `dynamictree reconstruct` makes a tree of photos")
    names = ", ".join((*_SHAPE_SUFFIXES, *POINT_SUFFIXES))
    raise InputError(f"{path} is a folder, and no file in it ends in {names}; name the tree's file")


SourcePath = Annotated[
    Path,
    typer.Argument(
        callback=shape_file,
        help="A mesh: OBJ (with its MTL and textures beside it), PLY, GLB, glTF, STL, OFF, 3MF or COLLADA. Or a splat: "
        "PLY, .splat, SPZ, SOG, .ksplat, GLB. Or a scan: PLY without faces, XYZ, TXT, CSV, PTS, PCD, LAS, LAZ. Or a "
        "folder with one of them.",
    ),
]
OutputFolder = Annotated[
    Path, typer.Option("--output", "-o", help="Folder for the products; created if it does not exist.")
]
OutputFile = Annotated[
    Path, typer.Option("--output", "-o", dir_okay=False, help="File to write; its folder is created if needed.")
]
