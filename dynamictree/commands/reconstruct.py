"""`dynamictree reconstruct`: photos to cameras, a splat and a mesh."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from dynamictree.commands.interruption import Interrupted, stopping_on_signals
from dynamictree.commands.options import OutputFolder
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, tell
from dynamictree.errors import InputError
from dynamictree.files import published
from dynamictree.formats.companions import is_system_file
from dynamictree.formats.suffixes import PHOTO_SUFFIXES
from dynamictree.photo_requests import PHOTOS_OF_VIDEO, CutParams, PhotoParams


@with_request_options
def reconstruct(
    photos: Annotated[
        Path,
        typer.Argument(
            help="A folder of 8 to 300 photos (JPEG, PNG, WebP, TIFF), taken around the tree; cameras in it "
            "(transforms.json, a COLMAP model, poses_bounds.npy) and a folder `masks` are heeded. Or a film (MP4, MOV, "
            "WebM) of a walk around the tree."
        ),
    ],
    output: OutputFolder,
    params: PhotoParams,
    fresh: Annotated[bool, typer.Option(help="Start anew, whatever an interrupted run has left.")] = False,
    as_json: AsJson = False,
) -> None:
    """Find the cameras of photos, a splat and a mesh of what they show.

    An interrupted run leaves its finished stages in a folder beside the output; the same command continues there.
    """
    from dynamictree.commands.stage_progress import stage_progress
    from dynamictree.reconstruct import Progress
    from dynamictree.reconstruct import reconstruct as reconstruct_photos
    from dynamictree.reconstruct.from_request import options_of
    from dynamictree.reconstruct.recut import recut

    work = output.resolve().with_name(f"{output.resolve().name}.unfinished")
    if fresh:
        shutil.rmtree(work, ignore_errors=True)
    try:
        with (
            _photo_folder(photos, params.video_frames or PHOTOS_OF_VIDEO) as root,
            stopping_on_signals() as check,
            stage_progress(as_json=as_json) as report,
            published(output) as folder,
        ):
            paths = sorted(
                path
                for path in root.rglob("*")
                if path.suffix.lower() in PHOTO_SUFFIXES
                and path.is_file()
                and not is_system_file(path.relative_to(root).as_posix())
            )

            def on_progress(progress: Progress) -> None:
                report(progress)
                check()

            reconstruct_photos(paths, folder, options=options_of(params), root=root, work=work, on_progress=on_progress)
            cut = CutParams.part_of(params.model_dump())
            if cut.cuts or cut.scales:
                recut(folder, folder, cut)
            names = sorted(path.name for path in folder.iterdir())
            facts = json.loads((folder / "report.json").read_text())
    except BaseException as error:
        if (work / "views.json").exists():
            typer.echo(f"finished stages are in {work}; run the same command again to continue", err=True)
        else:
            shutil.rmtree(work, ignore_errors=True)
        if isinstance(error, Interrupted):
            typer.echo(f"dynamictree: {error}", err=True)
            raise SystemExit(error.exit_status) from None
        raise
    shutil.rmtree(work)
    tell({"files": [str(output / name) for name in names], **facts}, as_json=as_json)


@contextmanager
def _photo_folder(source: Path, video_frames: int) -> Iterator[Path]:
    """The folder itself; of a film, one with its sharpest frames, which are the same in every run.

    Raises:
        InputError: neither a folder nor a film.
    """
    if source.is_dir():
        yield source
        return
    from dynamictree.reconstruct.video_frames import SUFFIXES, write_sharp_frames

    if source.suffix.lower() not in SUFFIXES:
        raise InputError(f"{source} is no folder of photos and no film ({', '.join(SUFFIXES)}); give one of them")
    with tempfile.TemporaryDirectory() as folder:
        write_sharp_frames(source, Path(folder), video_frames)
        yield Path(folder)
