"""Read a job's photos or film in a confined child process, as `worker.parse` reads uploads.

`python -m worker.confined_reading`: request on stdin; on stdout a line of JSON per step, then one with the result.
The worker itself decodes only what the child has re-encoded. For a film the child may run ffmpeg and nothing else.
"""

import os
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from dynamictree.errors import DynamicTreeError, FormatError, InputError
from dynamictree.formats.film import ffmpeg_program
from dynamictree.reconstruct.film_photos import FrameRange, write_sharp_frames
from dynamictree.reconstruct.input_cameras import InputCamera
from dynamictree.reconstruct.photos import Given, OnPhoto, Photo, PhotoFile, read_photos
from jobs.storage.parser_process import FOLDER, child_environment
from worker.confine import confine

CHILD = "worker.confined_reading"
ERRORS = {error.code: error for error in (FormatError, InputError)}
"""Exceptions that the child may report, by code."""


class Request(BaseModel):
    """Files that the child reads, and its output folder: photos with the folder of their cameras, or a film."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    folder: Path
    photos: tuple[PhotoFile, ...] = ()
    root: Path | None = None
    film: Path | None = None
    wanted: int | tuple[FrameRange, ...] = 0  # number of frames to choose, or their stretches


class Answer(BaseModel):
    """Output of the child: a step, the result, or why the files cannot be used."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    step: tuple[int, ...] | None = None
    frames: list[Path] | None = None
    photos: list[Photo] | None = None
    cameras: list[dict[str, Any]] | None = None
    code: str | None = None
    message: str = ""


def read_confined(
    photos: Sequence[PhotoFile], root: Path | None, folder: Path, on_photo: OnPhoto
) -> tuple[Given, list[Photo]]:
    """Run `read_photos` in a confined child. An exception of `on_photo` ends the child and passes through.

    Raises:
        InputError: as `read_photos`, or the child crashed on a file.
    """
    answer = _run_child(Request(photos=tuple(photos), root=root, folder=folder), on_photo)
    assert answer.photos is not None
    return None if answer.cameras is None else tuple(map(InputCamera.from_json, answer.cameras)), answer.photos


def write_confined_frames(
    video: Path, folder: Path, wanted: int | Sequence[FrameRange], on_work: Callable[[], None]
) -> list[Path]:
    """Run `write_sharp_frames` in a confined child. An exception of `on_work` ends the child and passes through.

    Raises:
        InputError: as `write_sharp_frames`, or the child crashed on the film.
    """
    film = video.resolve()
    frames = wanted if isinstance(wanted, int) else tuple(wanted)
    try:
        answer = _run_child(Request(film=film, folder=folder, wanted=frames), on_work)
    except (FormatError, InputError) as error:
        raise type(error)(str(error).replace(film.name, video.name)) from error
    assert answer.frames is not None
    return answer.frames


def _run_child(request: Request, on_step: Callable[..., None]) -> Answer:
    """Run the child on a request; at the end of this call, end the child and the programs that it runs."""
    most_bytes = 16 * 2**20  # size of a line
    ends_within_s = 10.0  # time to exit after its output is closed
    request.folder.mkdir(parents=True, exist_ok=True)
    with subprocess.Popen(
        [sys.executable, "-P", "-m", CHILD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=child_environment(),
        cwd=FOLDER,
        start_new_session=True,
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            with suppress(BrokenPipeError):  # the child died before it read the request
                child.stdin.write(request.model_dump_json().encode())
                child.stdin.close()
            while line := child.stdout.readline(most_bytes):
                answer = Answer.model_validate_json(line)
                if answer.code is not None:
                    raise ERRORS.get(answer.code, InputError)(answer.message)
                if answer.step is None:
                    return answer
                on_step(*answer.step)
            child.wait(ends_within_s)
        finally:
            if child.returncode is None:
                os.killpg(child.pid, signal.SIGKILL)
    raise InputError(f"reading the files ended with exit code {child.returncode}; export them again, or reduce them")


def main() -> None:
    """In the child: drop access to all but the named files, then read them."""
    request = Request.model_validate_json(sys.stdin.buffer.read())
    answer_to = os.dup(1)
    os.dup2(2, 1)  # output of libraries must not mix with the response
    with os.fdopen(answer_to, "w") as stream:

        def tell(answer: Answer) -> None:
            stream.write(answer.model_dump_json() + "\n")
            stream.flush()

        try:
            tell(_photos(request, tell) if request.film is None else _frames(request, request.film, tell))
        except DynamicTreeError as error:
            tell(Answer(code=error.code, message=str(error)))


def _photos(request: Request, tell: Callable[[Answer], None]) -> Answer:
    files = [photo.path for photo in request.photos]
    if request.root is not None:
        files += [request.root, *request.root.rglob("*")]
    confine(request.folder, [path.resolve() for path in files])  # inputs are links into the folder of artifacts
    given, photos = read_photos(request.photos, request.root, request.folder, lambda *done: tell(Answer(step=done)))
    if given is None:
        return Answer(photos=photos)
    return Answer(photos=photos, cameras=[camera.to_json() for camera in given])


def _frames(request: Request, film: Path, tell: Callable[[Answer], None]) -> Answer:
    memory_bytes = 6 * 2**30  # limit per process; decoding 4K takes less than 1 GiB
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    confine(request.folder, [film], program=Path(ffmpeg_program()).resolve())
    tempfile.tempdir = str(request.folder)
    return Answer(frames=write_sharp_frames(film, request.folder, request.wanted, lambda: tell(Answer(step=()))))


if __name__ == "__main__":
    main()
