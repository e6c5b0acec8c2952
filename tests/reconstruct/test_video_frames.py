"""A film as input: its sharp frames become the photos."""

from pathlib import Path

import numpy as np
import pytest
import scipy.ndimage
from PIL import Image

from dynamictree.errors import FormatError, InputError
from dynamictree.reconstruct.film_photos import chosen_frames, write_sharp_frames
from dynamictree.render.video import write_mp4

pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")

NUM_FRAMES, NUM_CHOSEN = 80, 8
SHARP_EVERY = 5


@pytest.fixture
def film(rng: np.random.Generator, tmp_path: Path) -> Path:
    """Noise that drifts; of five frames one is sharp. Its brightness tells a frame's number."""
    noise = scipy.ndimage.zoom(rng.normal(size=(40, 40)), 8, order=1)
    frames = []
    for number in range(NUM_FRAMES):
        picture = np.roll(noise, 2 * number, axis=1)[:240]
        if number % SHARP_EVERY != 2:
            picture = scipy.ndimage.gaussian_filter(picture, 4)
        grey = np.clip(60 + number + 12 * picture, 0, 255).astype(np.uint8)
        frames.append(np.repeat(grey[..., None], 3, axis=2))
    path = tmp_path / "walk.mp4"
    with path.open("wb") as stream:
        write_mp4(frames, stream, 24.0)
    return path


def grey(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("L"), np.float64)


def test_the_photos_of_a_film_are_its_sharp_frames_in_order_and_spread_over_it(film: Path, tmp_path: Path) -> None:
    photos = write_sharp_frames(film, tmp_path / "photos", NUM_CHOSEN)
    pictures = [grey(path) for path in photos]
    levels = np.array([picture.mean() for picture in pictures])
    numbers = np.round(levels - levels[0]).astype(int)
    assert len(photos) == NUM_CHOSEN
    assert pictures[0].shape == (240, 320)
    assert np.all(np.abs(np.diff(numbers) - SHARP_EVERY * np.round(np.diff(numbers) / SHARP_EVERY)) <= 1)
    assert np.all(np.diff(numbers) >= SHARP_EVERY - 1)
    assert numbers[-1] > 0.7 * NUM_FRAMES


def test_a_film_gives_the_same_photos_again(film: Path, tmp_path: Path) -> None:
    first, again = (write_sharp_frames(film, tmp_path / name, NUM_CHOSEN) for name in ("first", "again"))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in again]


def test_each_stretch_gives_one_frame_and_no_two_are_neighbours(rng: np.random.Generator) -> None:
    for num_frames in (8, 9, 31, 400):
        chosen = chosen_frames(rng.random(num_frames), 8)
        assert np.all(np.diff(chosen) > 0)
        assert np.all(np.abs(chosen + 0.5 - (np.arange(8) + 0.5) * num_frames / 8) < 1 + 0.35 * num_frames / 8)
    assert np.diff(chosen).min() > 0.25 * num_frames / 8


def test_what_is_no_film_or_too_short_is_refused(film: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has 80 frames, 100 are to be chosen"):
        write_sharp_frames(film, tmp_path / "photos", 100)
    with pytest.raises(InputError, match="8 to 300"):
        write_sharp_frames(film, tmp_path / "photos", 7)
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(film.read_bytes()[:2000])
    with pytest.raises(FormatError, match="cannot be read as a film"):
        write_sharp_frames(broken, tmp_path / "photos")
