import subprocess
from io import BytesIO

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from dynamictree.errors import DynamicTreeError, InputError
from dynamictree.render import VIDEO_FORMATS, write_animation


def frames_of(number: int, height: int = 33, width: int = 47):
    """A bright square that wanders to the right over a grey ground."""
    for index in range(number):
        frame = np.full((height, width, 3), 90, np.uint8)
        frame[10:20, 2 + 3 * index : 12 + 3 * index] = 250
        yield frame


@pytest.mark.parametrize("film", ["webp", "gif"])
def test_an_animated_picture_gives_back_its_frames(film):
    stream = BytesIO()
    write_animation(frames_of(9), stream, fps=25.0, format=film)
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
        write_animation(frames_of(9), stream, fps=24.0, format="mp4")
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "film.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decoded = subprocess.run(command, capture_output=True, check=True)
    assert b"24 fps" in decoded.stderr
    pictures = np.frombuffer(decoded.stdout, np.uint8).reshape(9, 34, 48, 3)  # odd sides are padded to even ones
    for picture, frame in zip(pictures, frames_of(9), strict=True):
        assert np.abs(picture[:33, :47].astype(int) - frame).mean() < 5


@pytest.mark.parametrize("film", VIDEO_FORMATS)
def test_refuses_a_film_without_frames(film):
    with pytest.raises(InputError, match="no frames"):
        write_animation(iter(()), BytesIO(), fps=24.0, format=film)


@pytest.mark.parametrize("film", VIDEO_FORMATS)
@pytest.mark.parametrize("fps", [0.0, 1000.0, float("nan")])
def test_refuses_a_speed_that_the_format_cannot_hold(film, fps):
    with pytest.raises(InputError, match="fps is"):
        write_animation(frames_of(2), BytesIO(), fps=fps, format=film)


@pytest.mark.parametrize("film", VIDEO_FORMATS)
def test_refuses_frames_of_several_sizes(film):
    mixed = iter([np.zeros((32, 32, 3), np.uint8), np.zeros((32, 34, 3), np.uint8)])
    with pytest.raises(InputError, match="frame 1 is 34 x 32"):
        write_animation(mixed, BytesIO(), fps=24.0, format=film)


def test_tells_when_the_encoder_fails(monkeypatch):
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: "/bin/false")
    with pytest.raises(DynamicTreeError, match="ffmpeg ended with 1"):
        write_animation(frames_of(300, 330, 470), BytesIO(), fps=24.0, format="mp4")
