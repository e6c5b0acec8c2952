"""Moving pictures: MP4 through ffmpeg, animated WebP through Pillow."""

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

Picture = UInt8[np.ndarray, "_h _w 3"]  # of any size: whether all have one is checked as they come


@contextmanager
def spooled(frames: Iterable[Picture]) -> Iterator[UInt8[np.ndarray, "T H W 3"]]:
    """Pictures of one size on disk, for those who go through them more than once; gone at the end.

    Raises:
        InputError: no frames.
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
    """The size of the frames, and the frames, which are compared with it as they come."""
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
    """Write pictures of one size as a film, one at a time.

    Raises:
        DynamicTreeError: ffmpeg failed; the message holds its own.
        InputError: no frames, frames of several sizes, or too many a second.
    """
    import imageio_ffmpeg  # the extra `video`; only this format needs it

    shape, frames = _checked(frames, fps, most=240.0)
    # yuv420p halves the colour's resolution and wants even sides: one pixel of edge is repeated where a side is odd
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{shape[1]}x{shape[0]}", "-r", f"{fps:.6f}", "-i", "-"]
    coded = ["-an", "-vf", even, "-c:v", "libx264", "-crf", "18", "-preset", "medium", "-pix_fmt", "yuv420p"]
    with tempfile.NamedTemporaryFile(suffix=".mp4") as film, tempfile.TemporaryFile() as log:
        # a seekable file, so that the index can go to the front and browsers start before the end
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *source, *coded]
        command += ["-threads", "2", "-movflags", "+faststart", film.name]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log) as encoder:
            assert encoder.stdin is not None
            with suppress(BrokenPipeError):  # ffmpeg gave up; its log tells why
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
    """Write pictures of one size as an animated WebP that repeats for ever; raises as `write_mp4`."""
    _, frames = _checked(frames, fps, most=100.0)
    # Pillow wants all frames in memory or in one file of many pages; the file keeps memory small
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
