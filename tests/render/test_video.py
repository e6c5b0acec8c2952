import subprocess
from io import BytesIO

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from dynamictree.errors import DynamicTreeError, InputError
from dynamictree.render import write_mp4, write_webp


def frames_of(number: int, height: int = 33, width: int = 47):
    """A bright square that wanders to the right over a grey ground."""
    for index in range(number):
        frame = np.full((height, width, 3), 90, np.uint8)
        frame[10:20, 2 + 3 * index : 12 + 3 * index] = 250
        yield frame


def test_an_animated_picture_gives_back_its_frames():
    stream = BytesIO()
    write_webp(frames_of(9), stream, 25.0)
    stream.seek(0)
    with Image.open(stream) as image:
        assert image.n_frames == 9
        assert image.info["loop"] == 0
        for index, frame in enumerate(frames_of(9)):
            image.seek(index)
            image.load()
            assert image.info["duration"] == 40
            assert np.abs(np.asarray(image.convert("RGB")).astype(int) - frame).mean() < 4


def test_an_mp4_gives_back_its_frames(tmp_path):
    with (tmp_path / "film.mp4").open("wb") as stream:
        write_mp4(frames_of(9), stream, 24.0)
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "film.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decoded = subprocess.run(command, capture_output=True, check=True)
    assert b"24 fps" in decoded.stderr
    pictures = np.frombuffer(decoded.stdout, np.uint8).reshape(9, 34, 48, 3)  # odd sides are padded to even ones
    for picture, frame in zip(pictures, frames_of(9), strict=True):
        assert np.abs(picture[:33, :47].astype(int) - frame).mean() < 5


MIXED = [np.zeros((32, 32, 3), np.uint8), np.zeros((32, 34, 3), np.uint8)]


@pytest.mark.parametrize("write", [write_mp4, write_webp])
@pytest.mark.parametrize(
    ("frames", "fps", "message"),
    [
        ([], 24.0, "no frames"),
        (MIXED, 24.0, "frame 1 is 34 x 32"),
        *((MIXED[:1], fps, "fps is") for fps in (0.0, 1000.0, float("nan"))),
    ],
)
def test_refuses_what_is_no_film(write, frames, fps, message):
    with pytest.raises(InputError, match=message):
        write(frames, BytesIO(), fps)


def test_tells_when_the_encoder_fails(monkeypatch):
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: "/bin/false")
    with pytest.raises(DynamicTreeError, match="ffmpeg ended with 1"):
        write_mp4(frames_of(300, 330, 470), BytesIO(), 24.0)
