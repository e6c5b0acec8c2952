"""Lookup of files that a model refers to, and detection of files that operating systems add to an upload."""

import os
import unicodedata
from collections.abc import Iterator, Mapping
from functools import cached_property, lru_cache
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

_SUFFIXES = frozenset(
    [".mtl", ".bin", ".png", ".jpg", ".jpeg", ".webp", ".ktx2", ".tga", ".bmp", ".tif", ".tiff", ".dds"]
)
KTX2_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"
_SYSTEM_NAMES = frozenset({"__macosx", "thumbs.db", "ehthumbs.db", "desktop.ini", "icon\r", "@eadir", "$recycle.bin"})
"""Files that Finder, Windows and Synology put into folders and zips; hidden files begin with a dot."""
_CODE_PAGES = ("utf-8", "cp932", "gbk", "cp949", "big5", "cp1251", "cp866", "cp850", "cp1252")
"""Encodings of names in MTL files and in zips without the UTF-8 flag: Windows' code pages by language."""
_Path = tuple[str, ...]


class Companions(Mapping[str, bytes]):
    """Files that a model may name (MTL, buffers, textures): those in its folder and below, by relative path."""

    def __init__(self, model: Path) -> None:
        self._model = model
        self._folder = model.parent.resolve()

    @cached_property
    def _paths(self) -> dict[str, Path]:
        """Paths by relative name; symbolic links that lead outside are not followed."""
        most_entries = 10_000  # files and folders that are listed below a model's folder, in 0.1 s
        paths: dict[str, Path] = {}
        looked_at = 0
        for folder, folders, names in os.walk(self._folder):
            folders[:] = sorted(name for name in folders if not is_system_file(name))
            looked_at += len(folders) + len(names)
            for path in (Path(folder, name) for name in sorted(names) if not is_system_file(name)):
                if path.suffix.lower() in _SUFFIXES and path.resolve().is_relative_to(self._folder):
                    paths[path.relative_to(self._folder).as_posix()] = path
            if looked_at > most_entries:
                break
        paths.pop(self._model.name, None)
        return paths

    def __getitem__(self, name: str) -> bytes:
        return self._paths[name].read_bytes()

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)


def is_system_file(name: str) -> bool:
    """Whether an operating system put the file there: hidden files, `__MACOSX`, `Thumbs.db` and their like."""
    parts = name.replace("\\", "/").split("/")
    return any(part.lower() in _SYSTEM_NAMES or (part.startswith(".") and part not in (".", "..")) for part in parts)


def find_companion(name: str, companions: Mapping[str, bytes]) -> bytes | None:
    """Return the content of a file that a model refers to; None if it is missing or ambiguous.

    Paths are compared from their end, so that absolute paths of another machine work: the file that shares the most
    folders with the name is taken. Case, backslashes, percent codes, accents as one or two characters and names in
    another code page make no difference. Only `companions` is searched.
    """
    by_base = _by_base_name(tuple(companions))
    for path in _spellings(name.strip(), "latin-1"):
        companion = _nearest(path, by_base.get(path[-1], []))
        if companion is not None:
            return companions[companion]
    return None


def beside_model(model: str, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the files of an upload by path from the model's folder; files outside it keep their names."""
    folder = PurePosixPath(model).parent
    named = {}
    for name, content in files.items():
        path = PurePosixPath(name)
        named[str(path.relative_to(folder) if path.is_relative_to(folder) else path)] = content
    return named


def _nearest(path: _Path, candidates: list[tuple[_Path, str]]) -> str | None:
    """Return the candidate with the longest common end of the path, complete ones first; None if several remain."""
    ranked: dict[tuple[int, bool], set[str]] = {}
    for other, name in candidates:
        shared = next((i for i, (a, b) in enumerate(zip(path[::-1], other[::-1], strict=False)) if a != b), None)
        length = min(len(path), len(other)) if shared is None else shared
        ranked.setdefault((length, length == len(other)), set()).add(name)
    best = ranked[max(ranked)] if ranked else set[str]()
    return best.pop() if len(best) == 1 else None


@lru_cache(maxsize=4)
def _by_base_name(names: tuple[str, ...]) -> dict[str, list[tuple[_Path, str]]]:
    """Index files by base name, in all spellings."""
    index: dict[str, list[tuple[_Path, str]]] = {}
    for name in names:
        for path in _spellings(name, "cp437"):
            index.setdefault(path[-1], []).append((path, name))
    return index


def _spellings(name: str, misread_as: str) -> Iterator[_Path]:
    """Yield the parts of a path: as written, with percent codes decoded, and decoded by other code pages."""
    texts = [name, unquote(name)]
    if not name.isascii():
        try:
            raw = name.encode(misread_as)
        except UnicodeEncodeError:
            raw = b""
        texts += [raw.decode(page, "ignore") for page in _CODE_PAGES]
    for text in dict.fromkeys(texts):
        plain = unicodedata.normalize("NFC", text).casefold().replace("\\", "/")
        path = tuple(part.strip() for part in plain.split("/") if part.strip() not in ("", ".", ".."))
        if path and "\0" not in plain:
            yield path
