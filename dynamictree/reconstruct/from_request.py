"""Reconstruction as the command line and a job request it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from dynamictree.formats.suffixes import FILM_SUFFIXES, OTHER_FILM_SUFFIXES, PHOTO_SUFFIXES
from dynamictree.photo_requests import PHOTOS_OF_VIDEO, QUALITIES, CutParams, LearningParams
from dynamictree.plant.capture import Capture, carrying_mesh, with_still_parts
from dynamictree.reconstruct import Progress, Reconstruction, ReconstructOptions, reconstruct
from dynamictree.reconstruct.densify import DensityRules
from dynamictree.reconstruct.film_photos import FilmPhotos, WriteFrames
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.photo_input import ReadPhotos, read_photos
from dynamictree.reconstruct.progress import OnProgress
from dynamictree.reconstruct.recut import pack, recut, unpack
from dynamictree.reconstruct.video_frames import write_sharp_frames
from dynamictree.requests import ReconstructParams

_LEARNING = 0.95  # of the progress; the rest is the cut

Recall = Callable[[Literal["reconstruction"], Callable[[Path], None]], Path]


def options_of(params: LearningParams) -> ReconstructOptions:
    """Options of the reconstruction that a request asks for; box and height come after it."""
    limits = QUALITIES[params.quality]
    schedule = Schedule(
        num_steps=params.splat_steps or limits.num_steps,
        side_px=limits.splat_px,
        sh_degree=limits.sh_degree,
        rules=DensityRules(max_gaussians=limits.max_gaussians),
    )
    return ReconstructOptions(schedule=schedule, photo_px=limits.photo_px, max_views=limits.max_views)


def learn_scene(
    files: Sequence[Path],
    folder: Path,
    params: LearningParams,
    *,
    root: Path,
    work: Path,
    read_photos: ReadPhotos = read_photos,
    write_frames: WriteFrames = write_sharp_frames,
    on_progress: OnProgress,
    on_file: Callable[[Path], None] = lambda path: None,
) -> Reconstruction:
    """Reconstruct photos, or the sharp frames of a film, as a request asks for it; arguments as of `reconstruct`."""
    more_photos = None
    if files[0].suffix.lower() in (*FILM_SUFFIXES, *OTHER_FILM_SUFFIXES):
        film, count = files[0], params.video_frames or PHOTOS_OF_VIDEO
        root = work / f"frames-{count}-{film.stat().st_size}"
        beginning = Progress(stage="photos", share=0.0, total=0.0)
        frames = FilmPhotos(
            film=film, folder=root, count=count, on_work=lambda: on_progress(beginning), write_frames=write_frames
        )
        files, more_photos = frames.first(), frames.more
    return reconstruct(
        [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES],
        folder,
        options=options_of(params),
        root=root,
        work=work,
        more_photos=more_photos,
        read_photos=read_photos,
        on_progress=on_progress,
        on_file=on_file,
    )


def reconstruct_capture(
    files: Sequence[Path],
    folder: Path,
    params: ReconstructParams,
    *,
    root: Path,
    resume_dir: Path,
    recall: Recall,
    read_photos: ReadPhotos = read_photos,
    write_frames: WriteFrames = write_sharp_frames,
    on_progress: Callable[[float], None],
    on_file: Callable[[Path], None] = lambda path: None,
) -> Capture:
    """Reconstruct a splat and a mesh from photos; all that is made of them is written into the folder.

    Args:
        files: a film, or photos and what may come with them: masks, and cameras as `find_given` reads them.
        folder: for the results.
        params: height, training steps and box.
        root: the folder that the files lie in or below, by which they name one another.
        resume_dir: a folder for intermediate results; a second call continues there.
        recall: gives the scene that was learned from the same photos, if any, whatever the box and height were.
        read_photos: reads photos and camera files.
        write_frames: chooses photos from a film.
        on_progress: gets the share done in [0, 1]; what it raises passes through.
        on_file: as of `reconstruct`.

    Raises:
        InputError: a file is no photo or film, or there are too few or too many.
        ReconstructionError: the photos do not fit together.
        CameraSearchError: the program that looks for cameras failed.
    """

    def learn(archive: Path) -> None:
        learn_scene(
            files,
            folder,
            params,
            root=root,
            work=resume_dir,
            read_photos=read_photos,
            write_frames=write_frames,
            on_progress=lambda progress: on_progress(_LEARNING * progress.total),
            on_file=on_file,
        )
        pack(folder, archive)

    unpack(recall("reconstruction", learn), folder)
    cut = CutParams.part_of(params.model_dump())
    capture = recut(folder, folder, CutParams(height_m=params.height_m, marker_m=params.marker_m))
    if cut.cuts:
        capture = recut(folder, folder, cut, on_progress=lambda share: on_progress(_LEARNING + (1 - _LEARNING) * share))
    capture = with_still_parts(capture)
    return replace(capture, mesh=carrying_mesh(capture))
