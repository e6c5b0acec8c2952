"""Reconstruction as the command line and a job request it."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from dynamictree.formats.suffixes import FILM_SUFFIXES, PHOTO_SUFFIXES
from dynamictree.gaussian.capture import Capture, carrying_mesh, with_still_parts
from dynamictree.reconstruct import ReconstructOptions, reconstruct
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.photo_input import ReadPhotos, read_photos
from dynamictree.reconstruct.video_frames import write_sharp_frames
from dynamictree.requests import PHOTOS_OF_VIDEO, PhotoParams, ReconstructParams

WriteFrames = Callable[[Path, Path, int, Callable[[], None]], list[Path]]


def options_of(params: PhotoParams) -> ReconstructOptions:
    """Options of the reconstruction that a request asks for."""
    schedule = Schedule() if params.splat_steps is None else Schedule(num_steps=params.splat_steps)
    return ReconstructOptions(height_m=params.height_m, schedule=schedule)


def reconstruct_capture(
    files: Sequence[Path],
    folder: Path,
    params: ReconstructParams,
    *,
    root: Path,
    resume_dir: Path,
    read_photos: ReadPhotos = read_photos,
    write_frames: WriteFrames = write_sharp_frames,
    on_progress: Callable[[float], None],
) -> Capture:
    """Reconstruct a splat and a mesh from photos; all that is made of them is written into the folder.

    Args:
        files: a film, or photos and what may come with them: masks, and cameras as `find_given` reads them.
        folder: for the results.
        params: height, training steps and box.
        root: the folder that the files lie in or below, by which they name one another.
        resume_dir: a folder for intermediate results; a second call continues there.
        read_photos: reads photos and camera files.
        write_frames: chooses photos from a film.
        on_progress: gets the share done in [0, 1]; what it raises passes through.

    Raises:
        InputError: a file is no photo or film, or there are too few or too many.
        ReconstructionError: the photos do not fit together.
    """
    if files[0].suffix.lower() in FILM_SUFFIXES:
        root = resume_dir / "frames"
        files = _frames(files[0], root, params, write_frames, lambda: on_progress(0.0))
    result = reconstruct(
        [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES],
        folder,
        options=replace(options_of(params), box_m=params.box_m),
        root=root,
        work=resume_dir,
        read_photos=read_photos,
        on_progress=lambda progress: on_progress(progress.total),
    )
    capture = with_still_parts(Capture(cloud=result.splat, mesh=result.mesh))
    return replace(capture, mesh=carrying_mesh(capture, params))


def _frames(
    film: Path, folder: Path, params: PhotoParams, write_frames: WriteFrames, on_work: Callable[[], None]
) -> list[Path]:
    """The film's sharp frames in a folder, which an interrupted attempt may have finished."""
    if not folder.exists():
        unfinished = folder.with_suffix(".unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        write_frames(film, unfinished, params.video_frames or PHOTOS_OF_VIDEO, on_work)
        unfinished.rename(folder)
    return sorted(folder.iterdir())
