"""A film gives more frames where photos are missing."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from dynamictree.reconstruct.film_photos import Film, FilmPhotos, Stretch, frame_name, frame_of, stretches_to_fill
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.render.camera import Camera

FRAMES = list(range(4, 310, 10))  # of a film of 310 frames, one walk around


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
    return SparseModel(
        views=tuple(views),
        points=np.zeros((0, 3)),
        colors=np.zeros((0, 3), np.uint8),
        seen=np.zeros((0, 2), np.int64),
        reprojection_error_px=0.3,
    )


class Recorder:
    """Writes empty frames, and remembers what was wanted."""

    def __init__(self) -> None:
        self.wanted: list[int | Sequence[Stretch]] = []

    def write(
        self, film: Path, folder: Path, wanted: int | Sequence[Stretch], on_work: Callable[[], None]
    ) -> list[Path]:
        self.wanted.append(wanted)
        frames = (
            FRAMES if isinstance(wanted, int) else [part.first + row for part in wanted for row in range(part.count)]
        )
        folder.mkdir()
        paths = [folder / frame_name(frame) for frame in frames]
        for path in paths:
            path.touch()
        return paths


@pytest.fixture
def film() -> Recorder:
    return Recorder()


@pytest.fixture
def photos(film: Recorder, tmp_path: Path) -> FilmPhotos:
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


def test_a_walk_that_was_registered_all_around_needs_no_more(photos: FilmPhotos, film: Recorder) -> None:
    photos.first()
    assert photos.more(model(FRAMES)) == []
    assert photos.first() == sorted(photos.folder.iterdir())
    assert film.wanted == [len(FRAMES)]


def test_a_walk_of_half_a_circle_has_nothing_to_fill_its_gap_with(photos: FilmPhotos) -> None:
    photos.first()
    for path in photos.folder.iterdir():
        if frame_of(path.name) > 155:
            path.unlink()
    half = [frame for frame in FRAMES if frame < 155]
    assert stretches_to_fill(half, {frame: 360 * frame / 310 for frame in half}) == []


def test_a_fast_walk_is_sampled_more_closely_and_neighbours_are_not_asked_for() -> None:
    assert stretches_to_fill([0, 20, 40], {0: 350.0, 20: 35.0, 40: 50.0}) == [Stretch(1, 20, 4)]
    assert stretches_to_fill([0, 1, 2], {0: 0.0}) == []
