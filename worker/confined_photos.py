"""Read a job's photos and camera files in a confined child process, as `worker.parse` reads uploads.

`python -m worker.confined_photos`: request on stdin; on stdout one JSON line per photo, then one with the result.
The worker itself decodes only what the child has written anew.
"""

import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from dynamictree.errors import DynamicTreeError, InputError
from dynamictree.reconstruct.given import GivenCamera
from dynamictree.reconstruct.photo_input import Given, OnPhoto, read_photos
from dynamictree.reconstruct.photos import Photo, PhotoFile
from worker.confine import confine
from worker.confined_child import ERRORS, answering, answers

CHILD = "worker.confined_photos"


class PhotoRequest(BaseModel):
    """Files that the child process reads, and its output folder."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    photos: tuple[PhotoFile, ...]
    root: Path | None
    folder: Path


class PhotoAnswer(BaseModel):
    """Progress, the result, or why the files cannot be used."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    done: tuple[int, int] | None = None
    prepared: list[Photo] | None = None
    cameras: list[dict[str, Any]] | None = None
    code: str | None = None
    message: str = ""


def read_confined(
    photos: Sequence[PhotoFile], root: Path | None, folder: Path, on_photo: OnPhoto
) -> tuple[Given, list[Photo]]:
    """`read_photos` in a confined child. An exception of `on_photo` ends the child and passes through.

    Raises:
        InputError: as `read_photos`, or the child died of a file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    request = PhotoRequest(photos=tuple(photos), root=root, folder=folder)
    with closing(answers(CHILD, request)) as lines:
        while True:
            answer = PhotoAnswer.model_validate_json(next(lines))
            if answer.done is None:
                return _result(answer)
            on_photo(*answer.done)


def _result(answer: PhotoAnswer) -> tuple[Given, list[Photo]]:
    if answer.prepared is None:
        raise ERRORS.get(answer.code or "", InputError)(answer.message)
    if answer.cameras is None:
        return None, answer.prepared
    return tuple(_camera(fields) for fields in answer.cameras), answer.prepared


def _camera(fields: dict[str, Any]) -> GivenCamera:
    matrix = np.array(fields.pop("world_to_camera"), np.float64)
    return GivenCamera(**fields | {"params": tuple(fields["params"])}, world_to_camera=matrix)


def main() -> None:
    """Give up all but the files named, then read them."""
    request = PhotoRequest.model_validate_json(sys.stdin.buffer.read())
    confine(request.folder, _readable(request))
    with answering() as tell:
        try:
            given, prepared = read_photos(
                request.photos, request.root, request.folder, lambda *done: tell(PhotoAnswer(done=done))
            )
        except DynamicTreeError as error:
            tell(PhotoAnswer(code=error.code, message=str(error)))
            return
        cameras = None
        if given is not None:
            cameras = [vars(camera) | {"world_to_camera": camera.world_to_camera.tolist()} for camera in given]
        tell(PhotoAnswer(prepared=prepared, cameras=cameras))


def _readable(request: PhotoRequest) -> list[Path]:
    """The files named, and where their links lead: a job's inputs are links into the folder of artifacts."""
    files = [photo.path for photo in request.photos]
    if request.root is not None:
        files += [request.root, *request.root.rglob("*")]
    return [path.resolve() for path in files]


if __name__ == "__main__":
    main()
