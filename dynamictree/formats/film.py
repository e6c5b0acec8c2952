"""Films, read by ffmpeg: size and duration, a copy of the video stream, and decoded frames."""

import re
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from dynamictree.errors import FormatError, InputError
from dynamictree.formats.suffixes import OTHER_FILM_SUFFIXES
from dynamictree.photo_requests import MIN_PHOTOS

MAX_FILM_BYTES = 2 * 2**30
MAX_FILM_S = 300.0  # a walk around a tree takes half a minute to two minutes
MAX_FILM_FRAMES = 36_000  # MAX_FILM_S at 120 frames per second
MAX_FILM_PIXELS = 4096 * 2304  # what phones call 4K

_DECODERS = "h264,hevc,av1,libdav1d,vp8,vp9,mpeg4,mjpeg"  # codecs that phones, cameras and browsers record
_DURATION = re.compile(r"Duration: (\d+):(\d\d):(\d\d(?:\.\d+)?)")
_PICTURE = re.compile(r"Video: .*?\b(\d{1,5})x(\d{1,5})\b(?:.*?([\d.]+) fps)?")


@dataclass(frozen=True, kw_only=True)
class FilmFacts:
    """Size and duration of a film, from its header."""

    width: int
    height: int
    duration_s: float
    num_frames: int

    def require_usable(self, name: str) -> None:
        """Refuse a film that is too large, too long or too short.

        Raises:
            InputError: the message has the value found and the values allowed.
        """
        min_film_side_px = 240
        size = f"{name} has {self.width} x {self.height} pixels"
        if self.width * self.height > MAX_FILM_PIXELS:
            raise InputError(f"{size}; at most {MAX_FILM_PIXELS:,} in all (4K) are allowed; film or export it smaller")
        if min(self.width, self.height) < min_film_side_px:
            raise InputError(f"{size}; at least {min_film_side_px} per side are needed")
        if self.duration_s > MAX_FILM_S or self.num_frames > MAX_FILM_FRAMES:
            long = f"{name} takes {self.duration_s:.0f} s ({self.num_frames:,} frames)"
            raise InputError(f"{long}; at most {MAX_FILM_S:.0f} s and {MAX_FILM_FRAMES:,} frames are allowed; cut it")
        if self.num_frames < MIN_PHOTOS:
            few = f"{name} has {self.num_frames} frames; at least {MIN_PHOTOS} are needed"
            raise InputError(f"{few}; film a slow walk around the tree of half a minute or more")


def film_facts(video: Path, name: str) -> FilmFacts:
    """Read a film's header, and decode its first frame; `name` is for messages.

    Raises:
        FormatError: ffmpeg cannot read it, or its header has no duration.
    """
    with tempfile.TemporaryFile() as log:
        with decoded(video, "-frames:v", "1", "-f", "null", "-", name=name, log=log):
            pass
        log.seek(0)
        header = log.read().decode(errors="replace")
    duration, picture = _DURATION.search(header), _PICTURE.search(header)
    if duration is None or picture is None:
        raise FormatError(f"{name} has no duration or no picture in its header; export it again as MP4")
    hours, minutes, seconds = (float(part) for part in duration.groups())
    duration_s = 3600 * hours + 60 * minutes + seconds
    width, height, fps = picture.groups()
    num_frames = round(duration_s * float(fps or 0))
    return FilmFacts(width=int(width), height=int(height), duration_s=duration_s, num_frames=num_frames)


def copy_picture(video: Path, target: Path) -> None:
    """Copy the video stream to an MP4 file without re-encoding; drop sound, location, other tracks and device names.

    Raises:
        FormatError: ffmpeg cannot read it.
    """
    bare = ("-c", "copy", "-map_metadata", "-1", "-map_chapters", "-1", "-fflags", "+bitexact", "-flags", "+bitexact")
    with decoded(video, *bare, "-f", "mp4", str(target)):
        pass


@contextmanager
def decoded(video: Path, *output: str, name: str | None = None, log: IO[bytes] | None = None) -> Iterator[IO[bytes]]:
    """Run ffmpeg on a film and yield its standard output; its messages go to `log`.

    ffmpeg may open only local files and use only `_DECODERS`, whatever the film refers to. Errors use `name`.

    Raises:
        InputError: the extra `video` is not installed.
        FormatError: ffmpeg cannot read the film.
    """
    command = [ffmpeg_program(), "-nostdin", "-hide_banner", "-nostats", "-loglevel", "info" if log else "error"]
    command += ["-protocol_whitelist", "file,pipe", "-codec_whitelist", _DECODERS, "-threads", "2"]
    if video.suffix.lower() not in OTHER_FILM_SUFFIXES:
        command += ["-f", "mov"]
    command += ["-i", str(video), "-map", "0:v:0", *output]
    with tempfile.TemporaryFile() as own:
        errors = log or own
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors) as decoder:
            assert decoder.stdout is not None
            try:
                yield decoder.stdout
            except BaseException:
                with suppress(PermissionError):  # a sandboxed process may not kill others; its parent does
                    decoder.kill()
                raise
        if decoder.returncode != 0:
            errors.seek(0)
            *_, reason = errors.read().decode(errors="replace").strip().splitlines() or ["no reason is given"]
            raise FormatError(f"{name or video.name} cannot be read as a film: {reason[-200:]}")


def ffmpeg_program() -> str:
    """Return the path of ffmpeg.

    Raises:
        InputError: the extra `video` is not installed.
    """
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise InputError("a film is read by ffmpeg; install dynamictree[video]") from error
    return str(imageio_ffmpeg.get_ffmpeg_exe())
