"""Write videos: MP4 with ffmpeg, animated WebP with Pillow."""

import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import chain

import numpy as np
from jaxtyping import UInt8
from PIL import Image, TiffImagePlugin

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import DynamicTreeError, InputError

Picture = UInt8[np.ndarray, "_h _w 3"]  # any size; the writers check that all frames have the same


@contextmanager
def stored_frames(frames: Iterable[Picture]) -> Iterator[UInt8[np.ndarray, "T H W 3"]]:
    """Store pictures of one size in a temporary file, for repeated passes.

    Raises:
        InputError: there are no frames.
    """
    with tempfile.TemporaryFile() as spool:
        shape: tuple[int, ...] = ()
        count = 0
        for frame in frames:
            spool.write(np.ascontiguousarray(frame).tobytes())
            shape, count = frame.shape, count + 1
        if count == 0:
            raise InputError("there are no frames; at least one is needed")
        spool.flush()
        yield np.memmap(spool, np.uint8, "r", shape=(count, *shape))


def _checked(frames: Iterable[Picture], fps: float, *, most: float) -> tuple[tuple[int, ...], Iterator[Picture]]:
    """Return the shape of the frames, and an iterator that checks each frame's shape."""
    if not 0 < fps <= most:
        raise InputError(f"fps is {fps}; above 0 and at most {most:g} are allowed")
    rest = iter(frames)
    first = next(rest, None)
    if first is None:
        raise InputError("there are no frames; at least one is needed")
    return first.shape, _of_one_size(chain([first], rest), first.shape)


def _of_one_size(frames: Iterator[Picture], shape: tuple[int, ...]) -> Iterator[Picture]:
    for number, frame in enumerate(frames):
        if frame.shape != shape:
            size = f"frame {number} is {frame.shape[1]} x {frame.shape[0]} pixels"
            raise InputError(f"{size}, the first is {shape[1]} x {shape[0]}; all must be of one size")
        yield frame


def write_mp4(frames: Iterable[Picture], stream: ByteWriter, fps: float) -> None:
    """Write pictures of one size as an MP4 video, one at a time.

    Raises:
        DynamicTreeError: ffmpeg failed; the message includes its output.
        InputError: there are no frames, frames of several sizes, or too many per second.
    """
    import imageio_ffmpeg  # extra `video`, needed by this format only

    shape, frames = _checked(frames, fps, most=240.0)
    # yuv420p halves the resolution of colour and needs even sides: odd sides are padded by a pixel
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{shape[1]}x{shape[0]}", "-r", f"{fps:.6f}", "-i", "-"]
    coded = ["-an", "-vf", even, "-c:v", "libx264", "-crf", "18", "-preset", "medium", "-pix_fmt", "yuv420p"]
    with tempfile.NamedTemporaryFile(suffix=".mp4") as film, tempfile.TemporaryFile() as log:
        # a seekable file, so that the index moves to the front and browsers start before the end
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *source, *coded]
        command += ["-threads", "2", "-movflags", "+faststart", film.name]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log) as encoder:
            assert encoder.stdin is not None
            with suppress(BrokenPipeError):  # ffmpeg failed; its log has the reason
                for frame in frames:
                    encoder.stdin.write(np.ascontiguousarray(frame).tobytes())
                encoder.stdin.close()
        if encoder.returncode != 0:
            log.seek(0)
            raise DynamicTreeError(
                f"ffmpeg ended with {encoder.returncode}: {log.read().decode(errors='replace')[-500:]}"
            )
        shutil.copyfileobj(film, stream)


def write_webp(frames: Iterable[Picture], stream: ByteWriter, fps: float) -> None:
    """Write pictures of one size as an endlessly looping WebP; see `write_mp4` for exceptions."""
    _, frames = _checked(frames, fps, most=100.0)
    # Pillow needs all frames in memory or in one multi-page file, which saves memory
    with tempfile.TemporaryFile() as spool:
        with TiffImagePlugin.AppendingTiffWriter(spool) as pages:
            for frame in frames:
                Image.fromarray(frame).save(pages, format="TIFF")
                pages.newFrame()
        spool.seek(0)
        with Image.open(spool) as pages, tempfile.TemporaryFile() as film:
            pages.save(film, format="WEBP", save_all=True, duration=1000 / fps, loop=0, quality=80, method=3)
            film.seek(0)
            shutil.copyfileobj(film, stream)
