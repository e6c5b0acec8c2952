"""`dynamictree reconstruct`: photos to cameras, a splat and a mesh."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.options import OutputFolder
from dynamictree.commands.request_options import with_request_options
from dynamictree.errors import InputError
from dynamictree.files import published
from dynamictree.requests import PhotoParams
from dynamictree.terminal import AsJson, progress, tell


@with_request_options
def reconstruct(
    photos: Annotated[
        Path,
        typer.Argument(
            help="A folder of 8 to 300 photos (JPEG, PNG, WebP, TIFF), taken around the tree; cameras in it "
            "(transforms.json, a COLMAP model, poses_bounds.npy) and a folder `masks` are heeded."
        ),
    ],
    output: OutputFolder,
    params: PhotoParams,
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
            height_m=params.height_m,
            splat_steps=params.splat_steps,
        )
        names = sorted(path.name for path in folder.iterdir())
        told = json.loads((folder / "report.json").read_text())
    tell({"files": [str(output / name) for name in names], **told}, as_json=as_json)
