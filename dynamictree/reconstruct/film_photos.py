"""Choose photos from a film: sharp frames spread evenly, and more of them where the cameras leave a gap."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from shutil import rmtree

import numpy as np
import scipy.ndimage
from jaxtyping import Float64, Int64

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.film import MAX_FILM_FRAMES, decoded
from dynamictree.photo_requests import MAX_PHOTOS, MIN_PHOTOS, PHOTOS_OF_VIDEO, QUALITIES
from dynamictree.reconstruct.camera_circle import camera_circle, coverage_warnings
from dynamictree.reconstruct.upright_frame import find_upright_frame
from dynamictree.reconstruct.views import SparseModel

_REDUCED = "force_original_aspect_ratio=decrease:flags=lanczos"


@dataclass(frozen=True)
class FrameRange:
    """Range of a film's frames, from `first` up to `end`, from which `count` frames are to be chosen."""

    first: int
    end: int
    count: int


WriteFrames = Callable[[Path, Path, int | Sequence[FrameRange], Callable[[], None]], list[Path]]


def write_sharp_frames(
    video: Path,
    folder: Path,
    wanted: int | Sequence[FrameRange] = PHOTOS_OF_VIDEO,
    on_work: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write sharp frames of a film as `frame-00123.png` (frame number), rotated as players show it; return the paths.

    Needs the extra `video`.

    Args:
        video: the film.
        folder: folder for the frames.
        wanted: number of frames, spread evenly over the film, or ranges of the film.
        on_work: called while ffmpeg works; an exception in it ends ffmpeg.

    Raises:
        InputError: too few frames, a count out of range, or the extra is not installed.
        FormatError: ffmpeg cannot read the film.
    """
    if isinstance(wanted, int) and not MIN_PHOTOS <= wanted <= MAX_PHOTOS:
        raise InputError(f"{wanted} frames are asked for; a reconstruction takes {MIN_PHOTOS} to {MAX_PHOTOS} photos")
    sharpness = _sharpness(video, on_work)
    stretches = [FrameRange(0, len(sharpness), wanted)] if isinstance(wanted, int) else wanted
    if isinstance(wanted, int) and len(sharpness) < wanted:
        raise InputError(
            f"{video.name} has {len(sharpness)} frames, {wanted} are to be chosen; "
            "film a slow walk around the tree of half a minute or more"
        )
    frames = [
        part.first + int(frame)
        for part in stretches
        for frame in chosen_frames(sharpness[part.first : part.end], part.count)
    ]
    picked = "+".join(f"eq(n,{frame})" for frame in frames)
    folder.mkdir(parents=True, exist_ok=True)
    side_px = QUALITIES["high"].photo_px
    chosen = f"select='{picked}',scale='min({side_px},iw)':'min({side_px},ih)':{_REDUCED}"
    output = ("-vf", chosen, "-fps_mode", "passthrough", "-pix_fmt", "rgb24")  # phones film in 10 bits
    with decoded(
        video, *output, str(folder / "chosen-%04d.png"), "-progress", "-", "-stats_period", "0.25"
    ) as progress:
        for _ in progress:
            on_work()
    written = sorted(folder.glob("chosen-*.png"))
    return [path.rename(folder / frame_name(frame)) for frame, path in zip(sorted(frames), written, strict=True)]


def frame_name(frame: int) -> str:
    """Return the file name of a frame, counted from 0."""
    return f"frame-{frame:05d}.png"


def frame_of(name: str) -> int:
    """Return the frame's number in a name of `frame_name`."""
    return int(name.removeprefix("frame-").removesuffix(".png"))


def stretches_to_fill(frames: Sequence[int], azimuths_deg: Mapping[int, float]) -> list[FrameRange]:
    """List the ranges of a film that need more frames: next to frames without a camera, and where the walk was fast.

    Args:
        frames: numbers of the frames so far, in order.
        azimuths_deg: azimuths of the registered cameras, by frame.
    """
    wide_deg, filled_deg = 20.0, 10.0  # angle between neighbouring frames that needs more, and the one aimed at
    stretches = []
    for first, second in pairwise(frames):
        angle = filled_deg
        if first in azimuths_deg and second in azimuths_deg:
            angle = abs((azimuths_deg[second] - azimuths_deg[first] + 180) % 360 - 180)
            if angle <= wide_deg:
                continue
        count = min(max(2, int(angle / filled_deg)), second - first - 1)
        if count > 0:
            stretches.append(FrameRange(first + 1, second, count))
    return stretches


def chosen_frames(sharpness: Float64[np.ndarray, " F"], count: int) -> Int64[np.ndarray, " C"]:
    """Choose the sharpest frame near the middle of each of `count` parts of equal length."""
    centre = 0.7  # central share of a part in which its frame is chosen, so that chosen frames are not adjacent
    edges = np.linspace(0, len(sharpness), count + 1)
    margin = (edges[1] - edges[0]) * (1 - centre) / 2
    chosen = []
    for low, high in zip(edges[:-1] + margin, edges[1:] - margin, strict=True):
        first, last = int(low), max(int(high), int(low) + 1)
        chosen.append(first + int(np.argmax(sharpness[first:last])))
    return np.array(chosen)


def _sharpness(video: Path, on_work: Callable[[], None]) -> Float64[np.ndarray, " F"]:
    """Compute the variance of each frame's Laplacian, which blur by motion or focus lowers."""
    probe_px = 256  # side of the square to which frames are scaled; the distortion is the same for all frames of a film
    square = f"scale={probe_px}:{probe_px},format=gray"
    values = []
    with decoded(video, "-vf", square, "-fps_mode", "passthrough", "-f", "rawvideo", "-") as pixels:
        while frame := pixels.read(probe_px**2):
            grey = np.frombuffer(frame, np.uint8).reshape(probe_px, probe_px).astype(np.float32)
            values.append(scipy.ndimage.laplace(grey).var())
            on_work()
            if len(values) > MAX_FILM_FRAMES:
                raise FormatError(f"{video.name} has more than {MAX_FILM_FRAMES:,} frames, which are allowed; cut it")
    return np.array(values, np.float64)


@dataclass(frozen=True, kw_only=True)
class Film:
    """Film of a walk around the tree."""

    path: Path
    count: int = PHOTOS_OF_VIDEO  # number of frames chosen at first


@dataclass(frozen=True, kw_only=True)
class FilmPhotos:
    """Frames chosen from one film, in a folder that an interrupted attempt may have filled."""

    film: Film
    folder: Path
    on_work: Callable[[], None]  # called while the film is decoded; an exception in it stops that
    write_frames: WriteFrames = field(default=write_sharp_frames)

    def first(self) -> list[Path]:
        """Write sharp frames, spread evenly over the film, unless the folder exists; return all its frames."""
        if not self.folder.exists():
            self._add(self.film.count)
        return self._frames()

    def more(self, model: SparseModel) -> list[Path]:
        """Write more frames, once, where cameras are missing or far apart; return all frames, or none if none is new.

        Args:
            model: registered cameras.
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

    def _add(self, wanted: int | Sequence[FrameRange]) -> None:
        """Write frames to a temporary folder, and move them once they are complete."""
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
    upright = find_upright_frame(model, np.random.default_rng(0), ground=False)
    return model.transformed(1.0, upright.rotation, upright.origin)
