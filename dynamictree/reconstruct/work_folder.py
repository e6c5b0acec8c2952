"""Results of finished stages in a folder, so that an interrupted reconstruction continues where it was.

`photos.key` says which photos, masks and cameras the results belong to, `splat.key` with which schedule the splat was
learned. Results with another key are deleted before the work begins.
"""

import fcntl
import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

from dynamictree.errors import InputError
from dynamictree.files import replacing
from dynamictree.reconstruct.optimise import Schedule

_VERSION = 3  # of the files in the folder
_SPLAT_VERSION = 3  # of the way in which it is learned
_OF_PHOTOS = (
    *("photos", "sparse", "chosen", "undistorted", "masks", "undistorted-masks"),
    *("features.db", "features-whole.db", "pairs.txt", "views.json", "points.npz", "depths.npz"),
)
_OF_SPLAT = ("splat.npz",)


@dataclass(frozen=True, kw_only=True)
class WorkFolder:
    """Where each stage saves its result."""

    path: Path
    schedule: Schedule

    def extend(self, sources: Iterable[Path]) -> None:
        """Go on with more photos: features of the earlier ones stay, cameras are to be found anew."""
        (self.path / "views.json").unlink(missing_ok=True)
        photos_key = _photos_key(sources)
        _write_key(self.path / "photos.key", photos_key)
        _write_key(self.path / "splat.key", _schedule_key(photos_key, self.schedule))

    @property
    def photos(self) -> Path:
        """Prepared photos and masks."""
        return self.path / "photos"

    @property
    def depths(self) -> Path:
        """Depth maps of stereo."""
        return self.path / "depths.npz"

    @property
    def splat(self) -> Path:
        """State of the splat's optimisation."""
        return self.path / "splat.npz"


@contextmanager
def opened_work(path: Path, sources: Iterable[Path], schedule: Schedule) -> Iterator[WorkFolder]:
    """Use a folder alone, with what an earlier call with the same inputs left there.

    Args:
        path: the folder.
        sources: photos, masks and files with cameras, in order.
        schedule: of the splat.

    Raises:
        InputError: another process uses the folder.
    """
    path.mkdir(parents=True, exist_ok=True)
    with (path / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another process is at work in {path}; wait for it, or choose another output") from None
        photos_key = _photos_key(sources)
        _delete_unless(path, "photos.key", photos_key, (*_OF_PHOTOS, *_OF_SPLAT))
        _delete_unless(path, "splat.key", _schedule_key(photos_key, schedule), _OF_SPLAT)
        yield WorkFolder(path=path, schedule=schedule)


def _photos_key(sources: Iterable[Path]) -> str:
    digest = sha256(str(_VERSION).encode())
    for source in sources:
        with source.open("rb") as stream:
            content = sha256()
            while chunk := stream.read(2**20):
                content.update(chunk)
        digest.update(f"{source.name}\0{content.hexdigest()}\0".encode())
    return digest.hexdigest()


def _schedule_key(photos_key: str, schedule: Schedule) -> str:
    return sha256(
        (f"{photos_key} {_SPLAT_VERSION} " + json.dumps(asdict(schedule), sort_keys=True)).encode()
    ).hexdigest()


def _delete_unless(folder: Path, name: str, key: str, results: tuple[str, ...]) -> None:
    """Delete results that belong to another key, then write the key."""
    if (folder / name).is_file() and (folder / name).read_text() == key:
        return
    (folder / name).unlink(missing_ok=True)
    for result in results:
        if (folder / result).is_dir():
            shutil.rmtree(folder / result)
        else:
            (folder / result).unlink(missing_ok=True)
    _write_key(folder / name, key)


def _write_key(path: Path, key: str) -> None:
    with replacing(path) as stream:
        stream.write(key.encode())
