"""`dynamictree reconstruct`: photos to cameras, a splat and a mesh."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.options import OutputFolder
from dynamictree.errors import InputError
from dynamictree.files import published
from dynamictree.terminal import AsJson, progress, tell


def reconstruct(
    photos: Annotated[
        Path,
        typer.Argument(
            help="A folder of 8 to 300 photos (JPEG, PNG, WebP, TIFF), taken around the tree; cameras in it "
            "(transforms.json, a COLMAP model, poses_bounds.npy) and a folder `masks` are heeded."
        ),
    ],
    output: OutputFolder,
    height_m: Annotated[
        float | None, typer.Option(help="The tree's height [m], above 0 and below 1000; 1 m if unset.")
    ] = None,
    splat_steps: Annotated[
        int | None, typer.Option(min=100, max=30_000, help="How long the splat is learned; 3000 steps if unset.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find the cameras of photos, a splat and a mesh of what they show."""
    from dynamictree import pipeline

    if not photos.is_dir():
        raise InputError(f"{photos} is no folder; give the folder that holds the photos")
    paths = sorted(path for path in photos.rglob("*") if path.is_file())
    with progress(quiet=as_json) as report, published(output) as folder:
        pipeline.reconstruct(
            paths,
            folder,
            lambda done: report("reconstruct", done),
            root=photos,
            height_m=height_m,
            splat_steps=splat_steps,
        )
        names = sorted(path.name for path in folder.iterdir())
        told = json.loads((folder / "report.json").read_text())
    tell({"files": [str(output / name) for name in names], **told}, as_json=as_json)
