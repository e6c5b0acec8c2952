"""Reconstruction from the parameters of the command line or of a job."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from dynamictree.formats.suffixes import FILM_SUFFIXES, OTHER_FILM_SUFFIXES, PHOTO_SUFFIXES
from dynamictree.photo_requests import PHOTOS_OF_VIDEO, CutParams, LearningParams
from dynamictree.plant.capture import Capture, carrying_mesh, with_still_parts
from dynamictree.reconstruct import Progress, Reconstruction, reconstruct
from dynamictree.reconstruct.film_photos import Film
from dynamictree.reconstruct.options import options_of
from dynamictree.reconstruct.reconstruction import Callbacks
from dynamictree.reconstruct.recut import pack_folder, recut, unpack_folder
from dynamictree.requests import ReconstructParams

Recall = Callable[[Literal["reconstruction"], Callable[[Path], None]], Path]


def learn_scene(
    files: Sequence[Path],
    folder: Path,
    params: LearningParams,
    *,
    root: Path,
    work: Path,
    callbacks: Callbacks | None = None,
) -> Reconstruction:
    """Reconstruct photos, or sharp frames of a film, with a request's parameters; arguments as for `reconstruct`."""
    photos: Sequence[Path] | Film = [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES]
    if files[0].suffix.lower() in (*FILM_SUFFIXES, *OTHER_FILM_SUFFIXES):
        photos = Film(path=files[0], count=params.video_frames or PHOTOS_OF_VIDEO)
    return reconstruct(photos, folder, options=options_of(params), root=root, work=work, callbacks=callbacks)


def reconstruct_capture(
    files: Sequence[Path], folder: Path, params: ReconstructParams, *, work: Path, recall: Recall, callbacks: Callbacks
) -> Capture:
    """Reconstruct a splat and a mesh from photos, and write all results into the folder.

    Args:
        files: a film; or photos, optionally with masks and with camera files that `find_input_cameras` reads.
        folder: folder for the results.
        params: height, training steps and box.
        work: folder for intermediate results, from which a second call continues.
        recall: returns the cached scene of the same photos, for any box and height, or calls the function.
        callbacks: see `reconstruct`.

    Raises:
        InputError: a file is no photo or film, or there are too few or too many.
        ReconstructionError: the photos do not fit together.
        CameraSearchError: the process of structure from motion failed.
    """
    learning = 0.95  # share of the progress; the rest is the cut
    worked_s = 0.0

    def on_progress(progress: Progress) -> None:
        nonlocal worked_s
        worked_s = progress.worked_s
        callbacks.on_progress(replace(progress, total=learning * progress.total))

    def on_cut(share: float) -> None:
        total = learning + (1 - learning) * share
        callbacks.on_progress(Progress(stage="cut", share=share, total=total, worked_s=worked_s))

    def learn(archive: Path) -> None:
        root = Path(os.path.commonpath([path.parent for path in files]))
        listening = replace(callbacks, on_progress=on_progress)
        learn_scene(files, folder, params, root=root, work=work, callbacks=listening)
        pack_folder(folder, archive)

    unpack_folder(recall("reconstruction", learn), folder)
    cut = CutParams.part_of(params.model_dump())
    capture = recut(folder, folder, CutParams(height_m=params.height_m, marker_m=params.marker_m))
    if cut.cuts:
        capture = recut(folder, folder, cut, on_progress=on_cut)
    capture = with_still_parts(capture)
    return replace(capture, mesh=carrying_mesh(capture))
