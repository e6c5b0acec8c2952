"""Choose the sharp frames of a job's film in a confined child process that may run ffmpeg and nothing else.

`python -m worker.confined_film`: request on stdin; on stdout one JSON line per step, then one with the result.
"""

import resource
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from dynamictree.errors import DynamicTreeError, InputError
from dynamictree.formats.film import ffmpeg_program
from dynamictree.reconstruct.video_frames import Stretch, write_sharp_frames
from worker.confine import confine
from worker.confined_child import ERRORS, answering, answers

MEMORY_BYTES = 6 * 2**30
"""Of each process: decoding 4K takes below one."""


class FilmRequest(BaseModel):
    """A film, and where its frames go."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    video: Path
    folder: Path
    wanted: int | tuple[Stretch, ...]


class FilmAnswer(BaseModel):
    """A step, the frames, or why the film cannot be used."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    frames: list[Path] | None = None
    code: str | None = None
    message: str = ""


def write_confined_frames(
    video: Path, folder: Path, wanted: int | Sequence[Stretch], on_work: Callable[[], None]
) -> list[Path]:
    """`write_sharp_frames` in a confined child. An exception of `on_work` ends the child and passes through.

    Raises:
        InputError: as `write_sharp_frames`, or the child died of the film.
    """
    folder.mkdir(parents=True, exist_ok=True)
    frames = wanted if isinstance(wanted, int) else tuple(wanted)
    request = FilmRequest(video=video.resolve(), folder=folder, wanted=frames)
    with closing(answers("worker.confined_film", request)) as lines:
        while True:
            answer = FilmAnswer.model_validate_json(next(lines))
            if answer.frames is not None:
                return answer.frames
            if answer.code is not None:
                raise ERRORS.get(answer.code, InputError)(answer.message.replace(request.video.name, video.name))
            on_work()


def main() -> None:
    """Give up all but the film and ffmpeg, then choose the frames."""
    request = FilmRequest.model_validate_json(sys.stdin.buffer.read())
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    confine(request.folder, [request.video], program=Path(ffmpeg_program()).resolve())
    tempfile.tempdir = str(request.folder)
    with answering() as tell:
        try:
            frames = write_sharp_frames(request.video, request.folder, request.wanted, lambda: tell(FilmAnswer()))
        except DynamicTreeError as error:
            tell(FilmAnswer(code=error.code, message=str(error)))
        else:
            tell(FilmAnswer(frames=frames))


if __name__ == "__main__":
    main()
