"""Arguments and options that several commands share and that are no parameter of the method."""

from pathlib import Path
from typing import Annotated

import typer

SourcePath = Annotated[
    Path,
    typer.Argument(
        help="A mesh: OBJ (with its MTL and textures beside it), PLY, GLB, glTF or STL. Or a splat: PLY, .splat, SPZ, "
        "GLB. Or a scan: PLY without faces, XYZ text, LAS, LAZ."
    ),
]
OutputFolder = Annotated[
    Path, typer.Option("--output", "-o", help="Folder for the products; created if it does not exist.")
]
OutputFile = Annotated[
    Path, typer.Option("--output", "-o", dir_okay=False, help="File to write; its folder is created if needed.")
]
