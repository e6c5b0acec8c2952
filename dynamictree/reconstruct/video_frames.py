"""Photos of a film: the sharpest frame of each of equal stretches of time, as someone walks around the tree."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.ndimage
from jaxtyping import Float64, Int64

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.film import MAX_FILM_FRAMES, decoded
from dynamictree.formats.suffixes import FILM_SUFFIXES, OTHER_FILM_SUFFIXES
from dynamictree.photo_requests import MAX_PHOTOS, MIN_PHOTOS, PHOTOS_OF_VIDEO
from dynamictree.reconstruct.photos import LONG_SIDE_PX

SUFFIXES = (*FILM_SUFFIXES, *OTHER_FILM_SUFFIXES)
PROBE_PX = 256  # side of the squares on which sharpness is judged; their ratio is the same for all frames of a film
_REDUCED = "force_original_aspect_ratio=decrease:flags=lanczos"
_CENTRE = 0.7  # of a stretch, in whose middle its frame is chosen, so that two chosen ones are not neighbours


def write_sharp_frames(
    video: Path, folder: Path, count: int = PHOTOS_OF_VIDEO, on_work: Callable[[], None] = lambda: None
) -> list[Path]:
    """Write the sharpest frames of a film as PNG files, upright as players show it; gives their paths in order.

    `on_work` is called while ffmpeg works; what it raises ends ffmpeg and passes through.

    Needs the extra `video`.

    Raises:
        InputError: too few frames, a count that is not possible, or the extra is not installed.
        FormatError: not a film that ffmpeg reads.
    """
    if not MIN_PHOTOS <= count <= MAX_PHOTOS:
        raise InputError(f"{count} frames are asked for; a reconstruction takes {MIN_PHOTOS} to {MAX_PHOTOS} photos")
    sharpness = _sharpness(video, on_work)
    if len(sharpness) < count:
        raise InputError(
            f"{video.name} has {len(sharpness)} frames, {count} are to be chosen; "
            "film a slow walk around the tree of half a minute or more"
        )
    frames = chosen_frames(sharpness, count)
    picked = "+".join(f"eq(n,{frame})" for frame in frames)
    folder.mkdir(parents=True, exist_ok=True)
    chosen = f"select='{picked}',scale='min({LONG_SIDE_PX},iw)':'min({LONG_SIDE_PX},ih)':{_REDUCED}"
    output = ("-vf", chosen, "-fps_mode", "passthrough", "-pix_fmt", "rgb24")  # phones film in 10 bits
    with decoded(video, *output, str(folder / "frame-%04d.png"), "-progress", "-", "-stats_period", "0.25") as progress:
        for _ in progress:
            on_work()
    return sorted(folder.glob("frame-*.png"))


def chosen_frames(sharpness: Float64[np.ndarray, " F"], count: int) -> Int64[np.ndarray, " C"]:
    """Numbers of the sharpest frame about the middle of each of `count` stretches of equal length."""
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
