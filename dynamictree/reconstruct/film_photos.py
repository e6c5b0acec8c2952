"""Photos of a film: sharp frames spread over it, and more of them where the cameras found leave a gap."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree

import numpy as np

from dynamictree.photo_requests import PHOTOS_OF_VIDEO
from dynamictree.reconstruct.camera_circle import camera_circle, coverage_warnings
from dynamictree.reconstruct.stage import find_stage
from dynamictree.reconstruct.video_frames import Stretch, frame_of, stretches_to_fill, write_sharp_frames
from dynamictree.reconstruct.views import SparseModel

WriteFrames = Callable[[Path, Path, int | Sequence[Stretch], Callable[[], None]], list[Path]]


@dataclass(frozen=True, kw_only=True)
class Film:
    """A film of a walk around the tree."""

    path: Path
    count: int = PHOTOS_OF_VIDEO  # frames that are taken as photos at first


@dataclass(frozen=True, kw_only=True)
class FilmPhotos:
    """Frames of one film in a folder, which an interrupted attempt may have written."""

    film: Film
    folder: Path
    on_work: Callable[[], None]  # called while the film is decoded; an exception in it stops that
    write_frames: WriteFrames = field(default=write_sharp_frames)

    def first(self) -> list[Path]:
        """Write sharp frames, spread evenly over the film, unless the folder has some; returns all that it has."""
        if not self.folder.exists():
            self._add(self.film.count)
        return self._frames()

    def more(self, model: SparseModel) -> list[Path]:
        """Write frames, once, where no camera was found or neighbours are far apart; returns all, none if none is new.

        Args:
            model: the cameras that were found.
        """
        frames = [frame_of(path.name) for path in self._frames()]
        model = _upright(model)
        circle = camera_circle({view.source: view.camera for view in model.views})
        if len(frames) != self.film.count or not coverage_warnings(circle, len(model.views), len(frames)):
            return []
        azimuths_deg = dict(zip(map(frame_of, circle.photos), circle.azimuths_deg.tolist(), strict=True))
        stretches = stretches_to_fill(frames, azimuths_deg)
        if not stretches:
            return []
        self._add(stretches)
        return self._frames()

    def _add(self, wanted: int | Sequence[Stretch]) -> None:
        """Write frames beside the folder, and move them there once they are complete."""
        unfinished = self.folder.with_name(f"{self.folder.name}.unfinished")
        rmtree(unfinished, ignore_errors=True)
        written = self.write_frames(self.film.path, unfinished, wanted, self.on_work)
        if self.folder.exists():
            for path in written:
                path.rename(self.folder / path.name)
        else:
            unfinished.rename(self.folder)

    def _frames(self) -> list[Path]:
        return sorted(self.folder.glob("frame-*.png"))


def _upright(model: SparseModel) -> SparseModel:
    stage = find_stage(model, np.random.default_rng(0), ground=False)
    return model.transformed(1.0, stage.rotation, stage.origin)
