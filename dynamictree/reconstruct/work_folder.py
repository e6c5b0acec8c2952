"""Folder with the results of finished stages, from which an interrupted reconstruction continues.

Each key is a hash of a result's inputs: `photos.key` of photos, masks and cameras, `depths.key` also of the number of
views, `splat.key` also of the schedule. Results with another key are deleted before the work begins.
"""

import fcntl
import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path

from dynamictree.errors import InputError
from dynamictree.files import atomic_file
from dynamictree.reconstruct.options import ReconstructOptions

_OF_PHOTOS = (
    *("photos", "sparse", "chosen", "undistorted", "masks", "undistorted-masks"),
    *("features.db", "features-whole.db", "pairs.txt", "views.json", "points.npz", "times.json"),
)
PHOTOS, TIMES, DEPTHS, SPLAT = "photos", "times.json", "depths.npz", "splat.npz"
"""Prepared photos and masks; duration of each stage over all attempts; depth maps; state of the optimisation."""
_RESULTS = {"photos.key": _OF_PHOTOS, "depths.key": ("depths.npz",), "splat.key": ("splat.npz",)}
"""Files of each stage; if its key differs, they are deleted, and those of all later stages too."""


@contextmanager
def locked_work_folder(path: Path, sources: Iterable[Path], options: ReconstructOptions) -> Iterator[None]:
    """Lock a folder, and delete its results that belong to other inputs.

    Args:
        path: the folder.
        sources: photos, masks and files with cameras, in order.
        options: options of the reconstruction.

    Raises:
        InputError: another process uses the folder.
    """
    path.mkdir(parents=True, exist_ok=True)
    with (path / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another process is at work in {path}; wait for it, or choose another output") from None
        _delete_others(path, _keys(sources, options))
        yield


def extend_work(path: Path, sources: Iterable[Path], options: ReconstructOptions) -> None:
    """Continue with more photos: retain the features of the earlier ones, delete the cameras."""
    (path / "views.json").unlink(missing_ok=True)
    for name, key in _keys(sources, options).items():
        _write_key(path / name, key)


def _keys(sources: Iterable[Path], options: ReconstructOptions) -> dict[str, str]:
    depths_version, splat_version = 2, 5  # versions of the depth maps' file, and of the splat's optimisation
    photos = f"{_photos_key(sources)} {options.photo_px}"
    depths = f"{photos} {depths_version} {options.max_views}"
    splat = f"{depths} {splat_version} {json.dumps(asdict(options.schedule), sort_keys=True)}"
    keys = zip(_RESULTS, (photos, depths, splat), strict=True)
    return {name: sha256(meaning.encode()).hexdigest() for name, meaning in keys}


def _photos_key(sources: Iterable[Path]) -> str:
    version = 4  # version of the files in the folder
    digest = sha256(str(version).encode())
    for source in sources:
        with source.open("rb") as stream:
            content = sha256()
            while chunk := stream.read(2**20):
                content.update(chunk)
        digest.update(f"{source.name}\0{content.hexdigest()}\0".encode())
    return digest.hexdigest()


def _delete_others(folder: Path, keys: dict[str, str]) -> None:
    """Delete results with another key, and write the new keys."""
    for name, results in _RESULTS.items():  # a later key includes the inputs of the earlier ones
        if (folder / name).is_file() and (folder / name).read_text() == keys[name]:
            continue
        (folder / name).unlink(missing_ok=True)
        for result in results:
            if (folder / result).is_dir():
                shutil.rmtree(folder / result)
            else:
                (folder / result).unlink(missing_ok=True)
        _write_key(folder / name, keys[name])


def _write_key(path: Path, key: str) -> None:
    with atomic_file(path) as stream:
        stream.write(key.encode())
