"""Find files that a model refers to: by relative path, or by a unique base name."""

from collections.abc import Mapping
from pathlib import PurePosixPath
from urllib.parse import unquote

KTX2_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"


def find_companion(name: str, companions: Mapping[str, bytes]) -> bytes | None:
    """Content of a file that a model refers to; None if it was not uploaded.

    Backslashes, `./` and percent codes are understood. A path that leads outside of the model's folder, or an absolute
    one, is never followed.
    """
    plain = name.strip().replace("\\", "/")
    for spelling in (plain, unquote(plain)):
        path = PurePosixPath(spelling)
        if path.is_absolute() or ".." in path.parts or "\0" in spelling or ":" in spelling:
            continue
        if str(path) in companions:
            return companions[str(path)]
    base = PurePosixPath(unquote(plain)).name.lower()
    same = [other for other in companions if PurePosixPath(other).name.lower() == base]
    return companions[same[0]] if base and len(same) == 1 else None


def beside_model(model: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files of an upload by their paths from the model's own folder; those above it keep their names."""
    folder = PurePosixPath(model).parent
    named = {}
    for name, content in files.items():
        path = PurePosixPath(name)
        named[str(path.relative_to(folder) if path.is_relative_to(folder) else path)] = content
    return named
