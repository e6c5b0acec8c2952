"""Reconstruction as the command line and a job request it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from dynamictree.formats.suffixes import PHOTO_SUFFIXES
from dynamictree.gaussian.capture import Capture, carrying_mesh, with_still_parts
from dynamictree.reconstruct import ReconstructOptions, reconstruct
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.photo_input import ReadPhotos, read_photos
from dynamictree.requests import PhotoParams, ReconstructParams


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
    resume_dir: Path | None = None,
    read_photos: ReadPhotos = read_photos,
    on_progress: Callable[[float], None],
) -> Capture:
    """Reconstruct a splat and a mesh from photos; all that is made of them is written into the folder.

    Args:
        files: photos, and what may come with them: masks, `transforms.json`, a COLMAP model, `poses_bounds.npy`.
        folder: for the results.
        params: height, training steps and box.
        root: the folder that the files lie in or below, by which they name one another.
        resume_dir: a folder for intermediate results; a second call continues there.
        read_photos: reads photos and camera files.
        on_progress: gets the share done in [0, 1]; what it raises passes through.

    Raises:
        InputError: a file is no photo, or there are too few or too many.
        ReconstructionError: the photos do not fit together.
    """
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
