"""Photos of a film: the sharpest frame of each of equal stretches of time, as someone walks around the tree."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import scipy.ndimage
from jaxtyping import Float64, Int64

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.film import MAX_FILM_FRAMES, decoded
from dynamictree.photo_requests import MAX_PHOTOS, MIN_PHOTOS, PHOTOS_OF_VIDEO, QUALITIES

PROBE_PX = 256  # side of the squares on which sharpness is judged; their ratio is the same for all frames of a film
_REDUCED = "force_original_aspect_ratio=decrease:flags=lanczos"
_WIDE_DEG, _FILLED_DEG = 20.0, 10.0  # between neighbouring frames, of the 10 to 20° that photos should have
_CENTRE = 0.7  # of a stretch, in whose middle its frame is chosen, so that two chosen ones are not neighbours


@dataclass(frozen=True)
class Stretch:
    """Frames of a film from `first` up to `end`, of which `count` are wanted."""

    first: int
    end: int
    count: int


def write_sharp_frames(
    video: Path,
    folder: Path,
    wanted: int | Sequence[Stretch] = PHOTOS_OF_VIDEO,
    on_work: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write sharp frames of a film as `frame-00123.png` (its number), upright as players show it, and return them.

    Needs the extra `video`.

    Args:
        video: the film.
        folder: for the frames.
        wanted: a number of frames, spread evenly over the film; or parts of the film.
        on_work: called while ffmpeg works; an exception in it ends ffmpeg.

    Raises:
        InputError: too few frames, a count that is not possible, or the extra is not installed.
        FormatError: not a film that ffmpeg reads.
    """
    if isinstance(wanted, int) and not MIN_PHOTOS <= wanted <= MAX_PHOTOS:
        raise InputError(f"{wanted} frames are asked for; a reconstruction takes {MIN_PHOTOS} to {MAX_PHOTOS} photos")
    sharpness = _sharpness(video, on_work)
    stretches = [Stretch(0, len(sharpness), wanted)] if isinstance(wanted, int) else wanted
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
    """Name of the file of a film's frame, counted from 0."""
    return f"frame-{frame:05d}.png"


def frame_of(name: str) -> int:
    """The number in a name of `frame_name`."""
    return int(name.removeprefix("frame-").removesuffix(".png"))


def stretches_to_fill(frames: Sequence[int], azimuths_deg: Mapping[int, float]) -> list[Stretch]:
    """Parts of a film from which more frames are needed: beside frames without a camera, and where the walk was fast.

    Args:
        frames: numbers of the frames so far, in order.
        azimuths_deg: of the cameras that were found, by frame.
    """
    stretches = []
    for first, second in pairwise(frames):
        angle = _FILLED_DEG
        if first in azimuths_deg and second in azimuths_deg:
            angle = abs((azimuths_deg[second] - azimuths_deg[first] + 180) % 360 - 180)
            if angle <= _WIDE_DEG:
                continue
        count = min(max(2, int(angle / _FILLED_DEG)), second - first - 1)
        if count > 0:
            stretches.append(Stretch(first + 1, second, count))
    return stretches


def chosen_frames(sharpness: Float64[np.ndarray, " F"], count: int) -> Int64[np.ndarray, " C"]:
    """Numbers of the sharpest frame about the middle of each of `count` parts of equal length."""
    edges = np.linspace(0, len(sharpness), count + 1)
    margin = (edges[1] - edges[0]) * (1 - _CENTRE) / 2
    chosen = []
    for low, high in zip(edges[:-1] + margin, edges[1:] - margin, strict=True):
        first, last = int(low), max(int(high), int(low) + 1)
        chosen.append(first + int(np.argmax(sharpness[first:last])))
    return np.array(chosen)


def _sharpness(video: Path, on_work: Callable[[], None]) -> Float64[np.ndarray, " F"]:
    """Variance of the Laplacian of each frame: blur by motion or by focus takes it away."""
    square = f"scale={PROBE_PX}:{PROBE_PX},format=gray"
    values = []
    with decoded(video, "-vf", square, "-fps_mode", "passthrough", "-f", "rawvideo", "-") as pixels:
        while frame := pixels.read(PROBE_PX**2):
            grey = np.frombuffer(frame, np.uint8).reshape(PROBE_PX, PROBE_PX).astype(np.float32)
            values.append(scipy.ndimage.laplace(grey).var())
            on_work()
            if len(values) > MAX_FILM_FRAMES:
                raise FormatError(f"{video.name} has more than {MAX_FILM_FRAMES:,} frames, which are allowed; cut it")
    return np.array(values, np.float64)
