"""Options that several commands share, and what they mean in the library's terms."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynamictree.errors import InputError

if TYPE_CHECKING:
    from dynamictree.gaussian.capture import Box

SourcePath = Annotated[
    Path,
    typer.Argument(
        help="A mesh: OBJ (with its MTL and textures beside it), PLY, GLB, glTF or STL. Or a splat: PLY, .splat, SPZ, "
        "GLB. Or a scan: PLY without faces, XYZ text, LAS, LAZ."
    ),
]
BoxCorners = Annotated[
    str | None,
    typer.Option(
        "--box", help="Of a splat or scan, only what is inside moves: x,y,z,x,y,z of low and high corner [m, +Z up]."
    ),
]
UpAxis = Annotated[
    str | None, typer.Option(help="Up axis of the input: +X, -X, +Y, -Y, +Z or -Z; detected if not given.")
]
UnitM = Annotated[
    float | None, typer.Option(help="Metres a unit of the input, > 0 (0.01 for centimetres); detected if not given.")
]
Resolution = Annotated[int, typer.Option(help="Voxels along the largest extent: 32, 64, 128, 256 or 512.")]
Seed = Annotated[int, typer.Option(min=0, max=2**63 - 1, help="The same seed gives the same motion.")]
Preset = Annotated[str, typer.Option(help="The model that generates the motion.")]
NumSteps = Annotated[
    int | None, typer.Option(min=1, max=1000, help="Sampler steps; the preset's own number if not given.")
]
WindSpeed = Annotated[float, typer.Option(min=0, max=30, help="Mean wind speed [m/s].")]
WindDirection = Annotated[
    float, typer.Option(min=-360, max=360, help="Where the wind blows to [degrees from +X towards +Y].")
]
Gust = Annotated[float, typer.Option(min=0, max=2, help="Standard deviation of the wind's speed over its mean.")]
OutputFolder = Annotated[Path, typer.Option("--output", "-o", help="Folder for the products; made if it is not there.")]
OutputFile = Annotated[
    Path, typer.Option("--output", "-o", dir_okay=False, help="File to write; its folder is made if it is not there.")
]


def box_of(corners: str | None) -> "Box | None":
    """The corners of `--box`.

    Raises:
        InputError: they are not six numbers.
    """
    if corners is None:
        return None
    try:
        x0, y0, z0, x1, y1, z1 = (float(value) for value in corners.split(","))
    except ValueError:
        raise InputError(f"--box is {corners!r}; six numbers are needed: x,y,z,x,y,z of low and high corner") from None
    return (x0, y0, z0), (x1, y1, z1)
