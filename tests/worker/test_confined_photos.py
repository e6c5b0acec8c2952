"""Photos and camera files of a job are read by a confined child, with the same result as without it."""

import json
import sys
from pathlib import Path

import numpy as np
import PIL.Image
import psutil
import pytest
from PIL import Image

from dynamictree.reconstruct.photos import list_photos, read_photos
from worker.confined_reading import CHILD, read_confined

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Landlock and seccomp are Linux's")


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    root = tmp_path / "photos"
    root.mkdir()
    paths = [root / f"{number}.png" for number in range(8)]
    for number, path in enumerate(paths):
        Image.effect_noise((400, 300), 10 + number).convert("RGB").save(path)
    return paths


def _give_cameras(root: Path) -> None:
    poses = np.tile(np.eye(4), (8, 1, 1))
    poses[:, 0, 3] = np.arange(8)  # cameras at one place are refused
    frames = [{"file_path": f"{number}.png", "transform_matrix": pose.tolist()} for number, pose in enumerate(poses)]
    lens = {"fl_x": 300.0, "fl_y": 300.0, "cx": 200.0, "cy": 150.0, "w": 400, "h": 300}
    (root / "transforms.json").write_text(json.dumps(lens | {"frames": frames}))


@pytest.mark.parametrize("with_cameras", [False, True])
def test_the_child_is_confined_and_reads_what_the_library_reads(photos, tmp_path, monkeypatch, with_cameras) -> None:
    root = photos[0].parent
    if with_cameras:  # links too, as a worker fetches inputs from a folder of artifacts
        _give_cameras(root)
        (tmp_path / "artifacts").mkdir()
        for number, path in enumerate(photos):
            path.symlink_to(path.rename(tmp_path / "artifacts" / str(number)))
    listed, reported = list_photos(photos, root), []
    expected = read_photos(listed, root, tmp_path / "own", lambda *_: None)

    def never(*_: object, **__: object) -> None:
        raise AssertionError("decoded in this process")

    monkeypatch.setattr(PIL.Image, "open", never)

    def look(*done: int) -> None:
        reported.append(done)
        [child] = [one for one in psutil.Process().children() if CHILD in one.cmdline()]
        status = Path(f"/proc/{child.pid}/status").read_text()
        state = dict(line.split(":\t") for line in status.splitlines() if line.startswith(("Secc", "NoNew")))
        assert (state["NoNewPrivs"], state["Seccomp"]) == ("1", "2")
        assert not [name for name in child.environ() if name.startswith(("DYNAMICTREE", "AWS"))]

    given, prepared = read_confined(listed, root, tmp_path / "confined", look)
    assert prepared == expected[1]
    assert reported == [(done, 8) for done in range(9)]
    for photo in prepared:
        assert (tmp_path / "confined" / photo.name).read_bytes() == (tmp_path / "own" / photo.name).read_bytes()
    assert (given is None) == (not with_cameras)
    for camera, same in zip(given or (), expected[0] or (), strict=True):
        assert vars(camera) | {"world_to_camera": 0} == vars(same) | {"world_to_camera": 0}
        np.testing.assert_array_equal(camera.world_to_camera, same.world_to_camera)
