"""An interrupted reconstruction continues where it was, whatever ended it."""

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import psutil
import pycolmap
import pytest

from dynamictree.errors import InputError
from dynamictree.photo_requests import MIN_PHOTOS, LearningParams, Quality
from dynamictree.reconstruct import ReconstructOptions, mapping
from dynamictree.reconstruct.options import options_of
from dynamictree.reconstruct.photos import Photo, list_photos, prepare_photos
from dynamictree.reconstruct.work_folder import locked_work_folder
from tests.reconstruct.conftest import Orbit
from tests.reconstruct.test_input_cameras import write_transforms

RUN = """
import os, signal, sys
from pathlib import Path
from dynamictree.reconstruct import ReconstructOptions, Callbacks, reconstruct
from dynamictree.reconstruct.optimise import Schedule

os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # on one core COLMAP gives the same bits again
root, out, work = (Path(path) for path in sys.argv[1:4])
stage, share = sys.argv[4], float(sys.argv[5])

def on_progress(progress):
    if progress.stage == stage and progress.share >= share:
        os.kill(os.getpid(), signal.SIGKILL)

schedule = Schedule(num_steps=60, side_px=160, check_every=20, coarser=((0.5, 2),), densify_every=20)
photos = sorted(root.glob("*.jpg"))
options, listening = ReconstructOptions(schedule=schedule), Callbacks(on_progress=on_progress)
reconstruct(photos, out, options=options, root=root, work=work, callbacks=listening)
"""
KILLED_AT = (
    *(("photos", 0.3), ("cameras", 0.0), ("cameras", 0.4), ("cameras", 0.9), ("depth", 0.0), ("depth", 0.3)),
    *(("depth", 0.7), ("splat", 0.0), ("splat", 0.6), ("mesh", 0.0)),
)
SAVED = ("views.json", "depths.npz")  # the splat's state is saved while it is learned, too
PRODUCTS = ("cameras.json", "mesh.ply", "scene.ply", "splat.ply")


@pytest.fixture
def photos(orbit: Orbit, tmp_path) -> Path:
    """The fewest photos that are taken, half way around, with their cameras."""
    folder = tmp_path / "photos"
    folder.mkdir()
    some = replace(orbit, photos=orbit.photos[:MIN_PHOTOS], cameras=orbit.cameras[:MIN_PHOTOS])
    for path in some.photos:
        shutil.copy(path, folder)
    write_transforms(folder, some)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(3600)  # two minutes of processor
def test_killed_at_ten_places_and_resumed_it_ends_with_the_same_files(photos, tmp_path):
    def run(name: str, stage: str, share: float) -> int:
        (tmp_path / name).mkdir(exist_ok=True)
        paths = [photos, tmp_path / name, tmp_path / f"{name}.work"]
        return subprocess.run([sys.executable, "-c", RUN, *map(str, paths), stage, str(share)], check=False).returncode

    work = tmp_path / "killed.work"
    seen = {}
    for stage, share in KILLED_AT:
        assert run("killed", stage, share) == -signal.SIGKILL
        finished = {name: (work / name).stat().st_mtime_ns for name in SAVED if (work / name).exists()}
        assert seen.items() <= finished.items()  # no finished stage is repeated
        seen = finished
    assert set(seen) == set(SAVED)
    assert (work / "splat.npz").exists()
    assert run("killed", "never", 0.0) == 0
    assert run("whole", "never", 0.0) == 0
    for name in PRODUCTS:
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_saves_its_work_when_it_is_stopped(photos, tmp_path, number):
    out = tmp_path / "out"
    options = ["--splat-steps", "300", "--json"]
    command = [sys.executable, "-m", "dynamictree.cli", "reconstruct", str(photos), "-o", str(out), *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        events = []
        for line in child.stderr:
            events.append(json.loads(line))
            if events[-1]["stage"] == "splat" and events[-1]["share"] > 0 and child.poll() is None:
                child.send_signal(number)
                break
        words = child.stderr.read()
    assert child.returncode == 128 + number
    work = tmp_path / "out.unfinished"
    assert f"finished stages are in {work}; run the same command again to continue" in words
    assert {"views.json", "depths.npz", "splat.npz"} <= {path.name for path in work.iterdir()}
    assert not out.exists()
    stages = [event["stage"] for event in events]
    assert list(dict.fromkeys(stages)) == ["photos", "cameras", "depth", "splat"]
    assert [event["total"] for event in events] == sorted(event["total"] for event in events)


def test_results_outlast_what_they_do_not_depend_on(tmp_path):
    """A better quality goes on with the cameras of the draft, unless it reads larger photos."""
    results = {"views.json", "times.json", "depths.npz", "splat.npz"}
    photo, work = tmp_path / "a.jpg", tmp_path / "work"
    photo.write_bytes(b"one")

    def left(quality: Quality, splat_steps: int | None = None) -> set[str]:
        options = options_of(LearningParams(quality=quality, splat_steps=splat_steps))
        with locked_work_folder(work, [photo], options):
            there = {name for name in results if (work / name).exists()}
            for name in results:
                (work / name).touch()
        return there

    assert left("draft") == set()
    assert left("draft") == results
    assert left("draft", 100) == results - {"splat.npz"}
    assert left("standard") == {"views.json", "times.json"}
    assert left("high") == set()
    photo.write_bytes(b"two")
    assert left("high") == set()


def test_two_runs_do_not_share_a_work_folder(tmp_path):
    with (
        locked_work_folder(tmp_path / "work", [], ReconstructOptions()),
        pytest.raises(InputError, match="another process is at work in"),
        locked_work_folder(tmp_path / "work", [], ReconstructOptions()),
    ):
        pass


@pytest.mark.slow
def test_the_camera_process_ends_with_its_killed_parent(orbit, tmp_path):
    code = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from dynamictree.reconstruct import Callbacks, reconstruct\n"
        "def kill(progress):\n"
        "    if progress.stage == 'cameras' and progress.share > 0: os.kill(os.getpid(), signal.SIGKILL)\n"
        "folder, photos = Path(sys.argv[1]), [Path(p) for p in sys.argv[2:]]\n"
        "reconstruct(photos, folder, work=folder, callbacks=Callbacks(on_progress=kill))\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path), *map(str, orbit.photos)], check=False)
    log, running = str(tmp_path / "mapping.log"), psutil.process_iter(["open_files"])
    camera_processes = [one for one in running if log in {file.path for file in one.info["open_files"] or ()}]
    assert psutil.wait_procs(camera_processes, timeout=10)[1] == []


def test_features_of_an_ended_search_are_not_sought_again(orbit, tmp_path):
    prepared = prepare_photos(list_photos(orbit.photos), tmp_path / "photos")

    def features(number: int) -> dict[str, tuple[int, int, bytes]]:
        search = mapping._Search(folder=tmp_path, photos=prepared[:number], given=None, part=(0.0, 1.0), threads=2)
        mapping._extract(search)
        with pycolmap.Database.open(search.database) as database:
            return {
                image.name: (image.image_id, image.camera_id, database.read_keypoints(image.image_id).tobytes())
                for image in database.read_all_images()
            }

    first = features(2)
    (tmp_path / "photos" / prepared[0].name).unlink()  # nobody reads it again
    again = features(3)
    assert (len(first), len(again)) == (2, 3)
    assert all(again[name] == first[name] for name in first)
    assert len({camera for _, camera, _ in again.values()}) == 1


def test_a_search_without_masks_goes_on_where_that_with_masks_ended(tmp_path, capsys, monkeypatch):
    """Progress stood still for 225 s."""
    for step in ("_extract", "_match", "_map"):
        monkeypatch.setattr(mapping, step, lambda search: search.tell("features", 0, 1))
    mapping.map_photos(tmp_path, [Photo(source="a", name="a", width=1, height=1, focal_px=None, masked=True)], None)
    parts = [json.loads(line)[3:] for line in capsys.readouterr().out.splitlines()]
    assert parts == 3 * [[0.0, 0.9]] + 3 * [[0.9, 1.0]]
