"""Process that reads one upload, forked by `worker.parse_server`: request on stdin, response on stdout.

It drops what it does not need (memory, time, open files, the network, other programs and files) before it reads the
first byte.
"""

import os
import resource
import sys
import tempfile
import traceback
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import get_args

from PIL import Image, UnidentifiedImageError

from dynamictree.errors import DynamicTreeError
from dynamictree.formats.companions import beside_model
from dynamictree.formats.description import describe_capture, describe_mesh
from dynamictree.formats.film import copy_picture, ffmpeg_program, film_facts
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.photo import PHOTO_FORMATS, open_photo
from dynamictree.formats.source_file import read_capture, source_kind
from dynamictree.formats.suffixes import FILM_SUFFIXES, MASK_NAME, MASKS
from dynamictree.formats.tensors.bundle import write_bundle
from dynamictree.requests import Reading
from jobs.storage.parser_process import ParseAnswer, ParseRequest
from worker.confine import Mechanism, confine

MAX_FILES = 512
MAX_TRACEBACK = 4096
MAX_PIXELS = 50_000_000
MIN_PHOTO_PIXELS = 320 * 240
CAMERA_SUFFIXES = (".json", ".npy", ".txt", ".bin")


def main() -> None:
    """Read the request and the files, and write the response."""
    request = ParseRequest.model_validate_json(sys.stdin.buffer.read())
    _limit(request)
    answer_to = os.dup(1)
    os.dup2(2, 1)  # output of libraries must not mix with the response
    film = request.kind == "photos" and request.names[0].lower().endswith(FILM_SUFFIXES)
    holds: tuple[Mechanism, ...] = get_args(Mechanism)
    try:
        program = Path(ffmpeg_program()).resolve() if film else None
        holds = confine(request.prepared.parent, request.paths, program=program)
        answer = _film(request) if film else _photos(request) if request.kind == "photos" else _model(request)
    except DynamicTreeError as error:
        answer = ParseAnswer(code=error.code, message=str(error))
    except Exception as error:  # noqa: BLE001 (our own errors are reported too)
        # an ImportError means a library without memory to map it; a missing one is an error of the installation
        if isinstance(error, MemoryError | RecursionError | ImportError) and not isinstance(error, ModuleNotFoundError):
            detail = f"reading the file failed with {type(error).__name__}"
            allowed = f"{request.memory_bytes:,} bytes of memory are allowed"
            answer = ParseAnswer(code="input-too-costly", message=f"{detail}; {allowed}; decimate it")
        else:
            answer = ParseAnswer(code="internal-error", message=traceback.format_exc()[-MAX_TRACEBACK:])
    with os.fdopen(answer_to, "w") as stream:
        lacks = tuple(hold for hold in get_args(Mechanism) if hold not in holds)
        stream.write(answer.model_copy(update={"lacks": lacks}).model_dump_json())


def _limit(request: ParseRequest) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (request.memory_bytes, request.memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (request.cpu_s, request.cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_NOFILE, (MAX_FILES, MAX_FILES))


def _model(request: ParseRequest) -> ParseAnswer:
    """Read a mesh, a cloud, or both."""
    files = dict(zip(request.names, request.paths, strict=True))
    models = {}
    for name in request.names[: request.num_models]:
        with files[name].open("rb") as stream:
            models[name] = source_kind(stream, name)
    clouds = [name for name, (kind, _) in models.items() if kind == "cloud"]
    meshes = [name for name in models if name not in clouds]
    if len(clouds) > 1 or len(meshes) > 1:
        both = f"there are 2 {'clouds' if clouds else 'meshes'} ({', '.join(map(repr, models))})"
        return _unusable(f"{both}; send one, and what it names beside it")
    beside = {name: path for name, path in files.items() if name not in models}
    if clouds:
        return _cloud(request, clouds[0], models[clouds[0]][1], meshes[0] if meshes else None, beside)
    return _mesh(request, meshes[0], models[meshes[0]][1], beside)


def _cloud(
    request: ParseRequest, name: str, file_type: str, mesh: str | None, beside: Mapping[str, Path]
) -> ParseAnswer:
    paths = dict(zip(request.names, request.paths, strict=True))
    masks = [path for other, path in beside.items() if PurePosixPath(other).name == MASK_NAME]
    with ExitStack() as opened:
        capture = read_capture(
            opened.enter_context(paths[name].open("rb")),
            file_type=file_type,
            reading=Reading.part_of(request.reading),
            mask=opened.enter_context(masks[0].open("rb")) if masks else None,
            mesh=None if mesh is None else (mesh, opened.enter_context(paths[mesh].open("rb"))),
            companions=beside_model(mesh or name, {other: path.read_bytes() for other, path in beside.items()}),
        )
    with request.prepared.open("xb") as stream:
        write_bundle(capture, stream)
    return ParseAnswer(kind="cloud", summary=describe_capture(capture))


def _mesh(request: ParseRequest, name: str, file_type: str, beside: Mapping[str, Path]) -> ParseAnswer:
    companions = beside_model(name, {other: path.read_bytes() for other, path in beside.items()})
    with dict(zip(request.names, request.paths, strict=True))[name].open("rb") as source:
        mesh = read_mesh(source, file_type=file_type, reading=Reading.part_of(request.reading), companions=companions)
    with request.prepared.open("xb") as stream:
        write_bundle(mesh, stream)
    return ParseAnswer(kind="mesh", summary=describe_mesh(mesh))


def _photos(request: ParseRequest) -> ParseAnswer:
    Image.MAX_IMAGE_PIXELS = None  # checked below, from the header
    sizes, number = set(), 0
    for name, path in zip(request.names, request.paths, strict=True):
        if PurePosixPath(name).suffix.lower() in CAMERA_SUFFIXES:
            continue  # the job reads it with the photos
        number += PurePosixPath(name).parent.name != MASKS
        try:
            with open_photo(path, name) as image:
                sizes.add(image.size)
                pixels = image.size[0] * image.size[1]
                if not MIN_PHOTO_PIXELS <= pixels <= MAX_PIXELS:
                    allowed = f"{MIN_PHOTO_PIXELS:,} to {MAX_PIXELS:,} are allowed"
                    return _unusable(f"photo {name!r} has {pixels:,} pixels; {allowed}; scale it")
                image.draft("RGB", (image.size[0] // 8, image.size[1] // 8))
                image.load()
        except UnidentifiedImageError:
            accepted = ", ".join(PHOTO_FORMATS)
            return ParseAnswer(code="unsupported-format", message=f"{name!r} is no photo; {accepted} are accepted")
        except (OSError, SyntaxError, ValueError) as error:
            return _unusable(f"photo {name!r} is damaged: {error}; export it again")
    return ParseAnswer(summary={"num_photos": number, "largest_pixels": [float(n) for n in max(sizes)]})


def _film(request: ParseRequest) -> ParseAnswer:
    """Read a film of a walk around a tree: only its video track is copied; a job chooses sharp frames."""
    tempfile.tempdir = str(request.prepared.parent)
    facts = film_facts(request.paths[0], request.names[0])
    facts.require_usable(request.names[0])
    copy_picture(request.paths[0], request.prepared)
    largest = [float(facts.width), float(facts.height)]
    summary = {"num_photos": 1, "largest_pixels": largest, "film_s": facts.duration_s, "film_frames": facts.num_frames}
    return ParseAnswer(summary=summary)


def _unusable(message: str) -> ParseAnswer:
    return ParseAnswer(code="invalid-input", message=message)


if __name__ == "__main__":
    main()
