"""Photos of a film: the sharpest frame of each of equal stretches of time, as someone walks around the tree."""

import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
import scipy.ndimage
from jaxtyping import Float64, Int64

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.suffixes import MAX_PHOTOS, MIN_PHOTOS, PHOTOS_OF_VIDEO

SUFFIXES = (".mp4", ".mov", ".m4v", ".webm", ".mkv", ".avi")
PROBE_PX = 256  # side of the squares on which sharpness is judged; their ratio is the same for all frames of a film
_CENTRE = 0.7  # of a stretch, in whose middle its frame is chosen, so that two chosen ones are not neighbours


def write_sharp_frames(video: Path, folder: Path, *, count: int = PHOTOS_OF_VIDEO) -> list[Path]:
    """Write the sharpest frames of a film as PNG files, upright as players show it; gives their paths in order.

    Needs the extra `video`.

    Raises:
        InputError: too few frames, a count that is not possible, or the extra is not installed.
        FormatError: not a film that ffmpeg reads.
    """
    if not MIN_PHOTOS <= count <= MAX_PHOTOS:
        raise InputError(f"{count} frames are asked for; a reconstruction takes {MIN_PHOTOS} to {MAX_PHOTOS} photos")
    sharpness = _sharpness(video)
    if len(sharpness) < count:
        raise InputError(
            f"{video.name} has {len(sharpness)} frames, {count} are to be chosen; "
            "film a slow walk around the tree of half a minute or more"
        )
    frames = chosen_frames(sharpness, count)
    picked = "+".join(f"eq(n,{frame})" for frame in frames)
    folder.mkdir(parents=True, exist_ok=True)
    output = ("-vf", f"select='{picked}'", "-fps_mode", "passthrough", "-pix_fmt", "rgb24")  # phones film in 10 bits
    with _ffmpeg(video, *output, str(folder / "frame-%04d.png")):
        pass
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


def _sharpness(video: Path) -> Float64[np.ndarray, " F"]:
    """Variance of the Laplacian of each frame: blur by motion or by focus takes it away."""
    square = f"scale={PROBE_PX}:{PROBE_PX},format=gray"
    values = []
    with _ffmpeg(video, "-vf", square, "-fps_mode", "passthrough", "-f", "rawvideo", "-") as pixels:
        while frame := pixels.read(PROBE_PX**2):
            grey = np.frombuffer(frame, np.uint8).reshape(PROBE_PX, PROBE_PX).astype(np.float32)
            values.append(scipy.ndimage.laplace(grey).var())
    return np.array(values, np.float64)


@contextmanager
def _ffmpeg(video: Path, *output: str) -> Iterator[IO[bytes]]:
    """Run ffmpeg and give what it writes to its standard output. It opens local files only, whatever the film names.

    Raises:
        InputError: the extra `video` is not installed.
        FormatError: ffmpeg cannot read the film.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise InputError("a film is read by ffmpeg; install dynamictree[video]") from error
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-nostdin", "-loglevel", "error", "-protocol_whitelist", "file,pipe"]
    command += ["-i", str(video), "-map", "0:v:0", *output]
    with tempfile.TemporaryFile() as log:
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log) as decoder:
            assert decoder.stdout is not None
            yield decoder.stdout
        if decoder.returncode != 0:
            log.seek(0)
            *_, reason = log.read().decode(errors="replace").strip().splitlines() or ["no reason is given"]
            raise FormatError(f"{video.name} cannot be read as a film: {reason[-200:]}")
