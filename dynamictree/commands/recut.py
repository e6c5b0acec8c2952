"""`dynamictree recut`: cut the plant out of a finished reconstruction, without training again."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.options import OutputFolder
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, show_result
from dynamictree.files import atomic_folder
from dynamictree.photo_requests import CutParams


@with_request_options
def recut(
    source: Annotated[Path, typer.Argument(help="The output folder of `dynamictree reconstruct`, or of this command.")],
    output: OutputFolder,
    params: CutParams,
    as_json: AsJson = False,
) -> None:
    """Cut the plant out of a finished reconstruction and scale it, without training again.

    Choose the plant by a box, by strokes on photos (--scribble "IMG_3.jpg plant 0.5,0.4 0.5,0.7" and --scribble
    "IMG_3.jpg other 0.1,0.9", points as shares of the photo's width and height), or automatically (--only-plant).
    """
    from dynamictree.reconstruct.recut import recut as recut_folder

    with atomic_folder(output) as folder:
        recut_folder(source, folder, params)
        names = sorted(path.name for path in folder.iterdir())
        facts = json.loads((folder / "report.json").read_text())
    show_result({"files": [str(output / name) for name in names], **facts}, as_json=as_json)
