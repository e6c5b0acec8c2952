"""`dynamictree reconstruct`: reconstruct cameras, a splat and a mesh from photos."""

import json
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from dynamictree.commands.options import OutputFolder
from dynamictree.commands.request_options import with_request_options
from dynamictree.commands.terminal import AsJson, show_result
from dynamictree.errors import Cancelled, InputError
from dynamictree.files import atomic_folder
from dynamictree.formats.companions import is_system_file
from dynamictree.formats.suffixes import FILM_SUFFIXES, OTHER_FILM_SUFFIXES, PHOTO_SUFFIXES
from dynamictree.photo_requests import CutParams, PhotoParams

_BESIDE_PHOTOS = (".json", ".npy", ".txt", ".bin")  # files of cameras
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
ALL_FILM_SUFFIXES = (*FILM_SUFFIXES, *OTHER_FILM_SUFFIXES)


@with_request_options
def reconstruct(
    photos: Annotated[
        Path,
        typer.Argument(
            help="A folder of 8 to 300 photos (JPEG, PNG, WebP, TIFF, HEIC), taken around the tree; cameras in it "
            "(transforms.json, a COLMAP model, poses_bounds.npy) and a folder `masks` are used. Or a film (MP4, MOV, "
            "WebM) of a walk around the tree."
        ),
    ],
    output: OutputFolder,
    params: PhotoParams,
    fresh: Annotated[bool, typer.Option(help="Start again, without results of an interrupted run.")] = False,
    as_json: AsJson = False,
) -> None:
    """Reconstruct cameras, a splat and a mesh from photos or a film.

    An interrupted run saves finished stages in a folder beside the output; the same command continues it.
    """
    from dynamictree.commands.stage_progress import stage_progress
    from dynamictree.reconstruct import Callbacks, Progress
    from dynamictree.reconstruct.from_request import learn_scene
    from dynamictree.reconstruct.recut import recut

    files = _input_files(photos)
    work = output.resolve().with_name(f"{output.resolve().name}.unfinished")
    if fresh:
        shutil.rmtree(work, ignore_errors=True)
    try:
        with stopping_on_signals() as check, stage_progress(as_json=as_json) as report, atomic_folder(output) as folder:

            def on_progress(progress: Progress) -> None:
                report(progress)
                check()

            callbacks = Callbacks(on_progress=on_progress)
            learn_scene(files, folder, params, root=photos, work=work, callbacks=callbacks)
            cut = CutParams.part_of(params.model_dump())
            if cut.cuts or cut.scales:
                recut(folder, folder, cut)
            names = sorted(path.name for path in folder.iterdir())
            facts = json.loads((folder / "report.json").read_text())
    except BaseException as error:
        if (work / "features.db").exists():
            typer.echo(f"finished stages are in {work}; run the same command again to continue", err=True)
        else:
            shutil.rmtree(work, ignore_errors=True)
        if isinstance(error, Interrupted):
            typer.echo(f"dynamictree: {error}", err=True)
            raise SystemExit(error.exit_status) from None
        raise
    shutil.rmtree(work)
    show_result({"files": [str(output / name) for name in names], **facts}, as_json=as_json)


def _input_files(source: Path) -> list[Path]:
    """Return the photos in a folder and below it, or the film; refuse all else."""
    if source.is_dir():
        files = sorted(path for path in source.rglob("*") if path.is_file())
        files = [path for path in files if not is_system_file(path.relative_to(source).as_posix())]
        unused = [path.name for path in files if path.suffix.lower() not in (*PHOTO_SUFFIXES, *_BESIDE_PHOTOS)]
        if unused:
            typer.echo(f"{len(unused)} files are no photos and are not used: {', '.join(unused[:5])}", err=True)
        return [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES]
    if source.suffix.lower() not in ALL_FILM_SUFFIXES:
        films = ", ".join(ALL_FILM_SUFFIXES)
        raise InputError(f"{source} is no folder of photos and no film ({films}); give one of them")
    return [source]


class Interrupted(Cancelled):
    """Raised when a signal (Ctrl-C or SIGTERM) asks the command to stop."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.exit_status = 128 + number


@contextmanager
def stopping_on_signals() -> Iterator[Callable[[], None]]:
    """Yield a function that raises `Interrupted` once a signal has come; a second signal ends the process at once."""
    received: list[int] = []
    before = {number: signal.getsignal(number) for number in _SIGNALS}

    def remember(number: int, frame: FrameType | None) -> None:
        received.append(number)
        for each in _SIGNALS:
            signal.signal(each, signal.SIG_DFL)

    def check() -> None:
        if received:
            raise Interrupted(received[0])

    try:
        for number in _SIGNALS:
            signal.signal(number, remember)
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
