"""The films of a study: `FOLDER/METHOD/TREE.mp4`, and the pairs of methods that show the same tree."""

from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from jobs.errors import JobsError

MEDIA_TYPES = {".mp4": "video/mp4", ".webm": "video/webm", ".webp": "image/webp"}


class StudyError(JobsError):
    """A folder holds no films that could be compared."""


@dataclass(frozen=True, order=True)
class Pair:
    """Two methods, in alphabetical order, and the tree that both moved."""

    tree: str
    first: str
    second: str


@dataclass(frozen=True)
class Films:
    """Every film of a folder, by method and tree."""

    files: dict[tuple[str, str], Path]

    def pairs(self) -> list[Pair]:
        """Each two methods that moved the same tree, sorted."""
        methods_of: dict[str, list[str]] = defaultdict(list)
        for method, tree in sorted(self.files):
            methods_of[tree].append(method)
        return sorted(Pair(tree, *two) for tree, methods in methods_of.items() for two in combinations(methods, 2))

    def file(self, method: str, tree: str) -> Path:
        """The film of a method and a tree."""
        return self.files[method, tree]


def find_films(folder: Path) -> Films:
    """Look for films one level below the folder; a film's name without its ending is its tree.

    Raises:
        StudyError: no two methods have a film of the same tree, or a method has two of one tree.
    """
    files: dict[tuple[str, str], Path] = {}
    for path in sorted(folder.glob("*/*")):
        if path.suffix.lower() not in MEDIA_TYPES:
            continue
        key = (path.parent.name, path.stem)
        if key in files:
            raise StudyError(f"{files[key]} and {path} are both the film of {key[1]!r} by {key[0]!r}; keep one")
        files[key] = path
    films = Films(files)
    if not films.pairs():
        raise StudyError(
            f"{folder} holds {len(files)} films and no tree that two methods show; "
            f"lay them as {folder}/METHOD/TREE.mp4, with the same TREE for both methods"
        )
    return films
