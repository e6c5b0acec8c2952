"""The frames of a job's film are chosen by a confined child, with the same result as without it."""

import sys
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from dynamictree.errors import Cancelled, FormatError, InputError
from dynamictree.reconstruct.film_photos import write_sharp_frames
from tests.formats.films import write_film
from worker.confined_reading import write_confined_frames

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Landlock and seccomp are Linux's")

COUNT = 8


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """As a worker fetches it: a link to an artifact without a suffix."""
    (tmp_path / "artifacts").mkdir()
    stored = write_film(tmp_path / "walk.mp4", seconds=2.0).rename(tmp_path / "artifacts" / "a1b2")
    (tmp_path / "walk.mp4").symlink_to(stored)
    return tmp_path / "walk.mp4"


def test_the_child_writes_what_the_library_writes_and_ffmpeg_is_confined_too(film: Path, tmp_path: Path) -> None:
    own = write_sharp_frames(film, tmp_path / "own", COUNT)
    states = []

    def look() -> None:
        for child in psutil.Process().children(recursive=True):
            with suppress(psutil.Error, OSError):  # it has just ended
                if "ffmpeg" in (child.cmdline() or [""])[0]:
                    status = Path(f"/proc/{child.pid}/status").read_text()
                    rows = dict(line.split(":\t") for line in status.splitlines() if line.startswith(("Sec", "NoN")))
                    assert not [name for name in child.environ() if name.startswith(("DYNAMICTREE", "AWS"))]
                    states.append(rows)

    frames = write_confined_frames(film, tmp_path / "confined", COUNT, look)
    assert [path.name for path in frames] == [path.name for path in own]
    assert [path.read_bytes() for path in frames] == [path.read_bytes() for path in own]
    assert {(state["NoNewPrivs"], state["Seccomp"]) for state in states} == {("1", "2")}


def test_a_film_that_cannot_be_used_is_named(film: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"walk\.mp4 has 40 frames, 100 are to be chosen"):
        write_confined_frames(film, tmp_path / "out", 100, lambda: None)
    (tmp_path / "broken.mp4").write_bytes(film.read_bytes()[:3000])
    with pytest.raises(FormatError, match=r"broken\.mp4 cannot be read as a film"):
        write_confined_frames(tmp_path / "broken.mp4", tmp_path / "out", COUNT, lambda: None)


def test_a_cancelled_job_ends_the_child_and_ffmpeg(film: Path, tmp_path: Path) -> None:
    others = set(psutil.Process().children(recursive=True))
    running: set[psutil.Process] = set()

    def cancel() -> None:
        running.update(set(psutil.Process().children(recursive=True)) - others)
        if running:
            raise Cancelled("asked to stop")

    with pytest.raises(Cancelled):
        write_confined_frames(film, tmp_path / "out", COUNT, cancel)
    _, alive = psutil.wait_procs(list(running), timeout=10)
    assert not alive
    assert not list((tmp_path / "out").glob("frame-*.png"))
