"""The child that reads an upload: `python -m worker.parse`, request on stdin, answer on stdout. See jobs/parser.py.

It gives up what it does not need (memory, time, open files, core dumps) before it looks at the first byte.
"""

import os
import resource
import sys

from dynamictree.errors import DynamicTreeError
from jobs.parser import ParseAnswer, ParseRequest

MAX_FILES = 512
HEAD_BYTES = 64 * 1024
MAX_PIXELS = 50_000_000
MIN_PHOTO_PIXELS = 320 * 240
PHOTO_FORMATS = ("JPEG", "PNG", "TIFF", "WEBP")


def main() -> None:
    """Read the request, read the files, write the answer."""
    request = ParseRequest.model_validate_json(sys.stdin.buffer.read())
    _limit(request)
    answer_to = os.dup(1)
    os.dup2(2, 1)  # what a library prints is no answer
    try:
        answer = _photos(request) if request.kind == "photos" else _mesh(request)
    except DynamicTreeError as error:
        answer = ParseAnswer(code=error.code, message=str(error))
    except (MemoryError, RecursionError) as error:
        found = f"reading the file failed with {type(error).__name__}"
        allowed = f"{request.memory_bytes:,} bytes of memory are allowed"
        answer = ParseAnswer(code="input-too-costly", message=f"{found}; {allowed}; decimate it")
    with os.fdopen(answer_to, "w") as stream:
        stream.write(answer.model_dump_json())


def _limit(request: ParseRequest) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (request.memory_bytes, request.memory_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (request.cpu_s, request.cpu_s + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_NOFILE, (MAX_FILES, MAX_FILES))


def _mesh(request: ParseRequest) -> ParseAnswer:
    # numpy and trimesh come in only now, under the limits
    import numpy as np

    from dynamictree.formats.mesh_bundle import write_mesh_bundle
    from dynamictree.formats.mesh_file import read_mesh, sniff_file_type

    main_path, *others = request.paths
    companions = {name: path.read_bytes() for name, path in zip(request.names[1:], others, strict=True)}
    with main_path.open("rb") as source:
        file_type = sniff_file_type(source.read(HEAD_BYTES), request.names[0])
        source.seek(0)
        mesh = read_mesh(
            source, file_type=file_type, up_axis=request.up_axis, unit_m=request.unit_m, companions=companions
        )
    with request.prepared.open("xb") as stream:
        write_mesh_bundle(mesh, stream)
    low, high = np.min(mesh.vertices, axis=0), np.max(mesh.vertices, axis=0)
    return ParseAnswer(
        summary={
            "num_vertices": mesh.num_vertices,
            "num_faces": mesh.num_faces,
            "num_materials": len(mesh.materials),
            "extent_m": [float(extent) for extent in high - low],
            "low_m": [float(value) for value in low],
            "source_up_axis": mesh.source_up_axis,
            "source_scale": mesh.source_scale,
        }
    )


def _photos(request: ParseRequest) -> ParseAnswer:
    from PIL import Image, UnidentifiedImageError

    Image.MAX_IMAGE_PIXELS = None  # counted here, from the header
    sizes = set()
    for name, path in zip(request.names, request.paths, strict=True):
        try:
            with Image.open(path, formats=PHOTO_FORMATS) as image:
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
    largest = max(sizes)
    return ParseAnswer(summary={"num_photos": len(request.paths), "largest_pixels": [float(n) for n in largest]})


def _unusable(message: str) -> ParseAnswer:
    return ParseAnswer(code="invalid-input", message=message)


if __name__ == "__main__":
    main()
