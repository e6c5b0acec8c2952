"""A film as input: its sharp frames become the photos, and more of them where some are missing."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.ndimage
from PIL import Image

from dynamictree.errors import FormatError, InputError
from dynamictree.reconstruct import Callbacks, Progress, reconstruct, reconstruction
from dynamictree.reconstruct.film_photos import (
    Film,
    FilmPhotos,
    FrameRange,
    chosen_frames,
    frame_name,
    frame_of,
    stretches_to_fill,
    write_sharp_frames,
)
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.render.camera import Camera
from dynamictree.render.video import write_mp4
from tests.reconstruct.conftest import sparse_model

NUM_FRAMES, NUM_CHOSEN, SHARP_EVERY = 80, 8, 5
FRAMES = list(range(4, 310, 10))  # frames of a film of 310 frames, one walk around


def model(frames: Sequence[int]) -> SparseModel:
    """Cameras of a level walk around the origin, in a frame that is turned by 90°."""
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    views = []
    for frame in frames:
        angle = 2 * np.pi * frame / 310
        camera = Camera.look_at(np.array([3 * np.cos(angle), 3 * np.sin(angle), 0.8]), np.zeros(3))
        turned = Camera(
            position_m=turn @ camera.position_m, world_to_camera=camera.world_to_camera @ turn.T, focal=camera.focal
        )
        views.append(View(source=frame_name(frame), image=np.zeros((30, 40, 3), np.uint8), camera=turned))
    return sparse_model(views)


class Recorder:
    """Writes empty frames, and remembers what was wanted."""

    def __init__(self) -> None:
        self.wanted: list[int | Sequence[FrameRange]] = []

    def write(
        self, film: Path, folder: Path, wanted: int | Sequence[FrameRange], on_work: Callable[[], None]
    ) -> list[Path]:
        on_work()
        self.wanted.append(wanted)
        parts = [FrameRange(frame, frame, 1) for frame in FRAMES] if isinstance(wanted, int) else wanted
        frames = [part.first + row for part in parts for row in range(part.count)]
        folder.mkdir()
        paths = [folder / frame_name(frame) for frame in frames]
        for path in paths:
            path.touch()
        return paths


@pytest.fixture
def film() -> Recorder:
    return Recorder()


@pytest.fixture
def photos(film: Recorder, tmp_path) -> FilmPhotos:
    return FilmPhotos(
        film=Film(path=tmp_path / "walk.mp4", count=len(FRAMES)),
        folder=tmp_path / "frames",
        on_work=lambda: None,
        write_frames=film.write,
    )


def test_frames_are_added_where_neighbouring_ones_were_lost(photos: FilmPhotos) -> None:
    """Seven neighbouring frames of 31 had no camera, and 270 unused ones stayed unused."""
    assert len(photos.first()) == len(FRAMES)
    registered = [frame for frame in FRAMES if not 100 < frame < 170]
    frames = [frame_of(path.name) for path in photos.more(model(registered))]
    assert set(FRAMES) < set(frames)
    added = sorted(set(frames) - set(FRAMES))
    assert len(added) >= 14
    assert added[0] > 94
    assert added[-1] < 174
    assert photos.more(model(registered)) == []  # once


def test_progress_never_goes_back_while_more_frames_are_sought(film: Recorder, tmp_path, monkeypatch) -> None:
    """It fell from 0.32 to 0, and then stood still for 65 s."""
    models, totals = [model([frame for frame in FRAMES if not 100 < frame < 170])], []

    def find(*_: object, on_progress: Callable[[float], None], **__: object) -> SparseModel:
        on_progress(1.0)
        return models.pop()

    def listen(progress: Progress) -> None:
        totals.append(progress.total)

    monkeypatch.setattr(reconstruction, "find_cameras", find)
    (tmp_path / "walk.mp4").touch()
    callbacks = Callbacks(read_photos=lambda *_: (None, []), write_frames=film.write, on_progress=listen)
    with pytest.raises(IndexError):  # the second search is enough
        reconstruct(Film(path=tmp_path / "walk.mp4", count=len(FRAMES)), tmp_path, callbacks=callbacks)
    assert totals == sorted(totals)
    assert 0.1 < totals[-2] < totals[-1]


def test_a_walk_that_was_registered_all_around_needs_no_more(photos: FilmPhotos, film: Recorder) -> None:
    photos.first()
    assert photos.more(model(FRAMES)) == []
    assert photos.first() == sorted(photos.folder.iterdir())
    assert film.wanted == [len(FRAMES)]


def test_a_fast_walk_is_sampled_more_closely_and_neither_neighbours_nor_what_was_not_walked_are_asked_for() -> None:
    assert stretches_to_fill([0, 20, 40], {0: 350.0, 20: 35.0, 40: 50.0}) == [FrameRange(1, 20, 4)]
    assert stretches_to_fill([0, 1, 2], {0: 0.0}) == []
    half = [frame for frame in FRAMES if frame < 155]
    assert stretches_to_fill(half, {frame: 360 * frame / 310 for frame in half}) == []


@pytest.fixture
def sharp_film(rng, tmp_path) -> Path:
    """Noise that drifts; of five frames one is sharp. Its brightness tells a frame's number."""
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
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


def test_the_photos_of_a_film_are_its_sharp_frames_in_order_and_spread_over_it(sharp_film: Path, tmp_path) -> None:
    photos, again = (write_sharp_frames(sharp_film, tmp_path / name, NUM_CHOSEN) for name in ("first", "again"))
    assert [path.read_bytes() for path in photos] == [path.read_bytes() for path in again]
    pictures = [grey(path) for path in photos]
    levels = np.array([picture.mean() for picture in pictures])
    numbers = np.round(levels - levels[0]).astype(int)
    assert len(photos) == NUM_CHOSEN
    assert pictures[0].shape == (240, 320)
    assert np.all(np.abs(np.diff(numbers) - SHARP_EVERY * np.round(np.diff(numbers) / SHARP_EVERY)) <= 1)
    assert np.all(np.diff(numbers) >= SHARP_EVERY - 1)
    assert numbers[-1] > 0.7 * NUM_FRAMES


def test_each_stretch_gives_one_frame_and_no_two_are_neighbours(rng) -> None:
    for num_frames in (8, 9, 31, 400):
        chosen = chosen_frames(rng.random(num_frames), 8)
        assert np.all(np.diff(chosen) > 0)
        assert np.all(np.abs(chosen + 0.5 - (np.arange(8) + 0.5) * num_frames / 8) < 1 + 0.35 * num_frames / 8)
    assert np.diff(chosen).min() > 0.25 * num_frames / 8


def test_what_is_no_film_or_too_short_is_refused(sharp_film: Path, tmp_path) -> None:
    with pytest.raises(InputError, match="has 80 frames, 100 are to be chosen"):
        write_sharp_frames(sharp_film, tmp_path / "photos", 100)
    with pytest.raises(InputError, match="8 to 300"):
        write_sharp_frames(sharp_film, tmp_path / "photos", 7)
    broken = tmp_path / "broken.mp4"
    broken.write_bytes(sharp_film.read_bytes()[:2000])
    with pytest.raises(FormatError, match="cannot be read as a film"):
        write_sharp_frames(broken, tmp_path / "photos")
