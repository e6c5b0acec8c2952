"""A film of a drifting pattern, as a phone would send it: with sound, a place and a name of the device."""

import subprocess
from pathlib import Path

import pytest

PLACES = (b"loci", b"\xa9xyz")  # boxes of MP4 and of MOV
DEVICE = "Phone of Somebody"


def write_film(path: Path, *, seconds: float = 3.0, size: tuple[int, int] = (320, 240), fps: int = 20) -> Path:
    """Write a film through ffmpeg's own pattern; the suffix decides on MP4 or MOV."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
    picture = f"testsrc2=size={size[0]}x{size[1]}:rate={fps}:duration={seconds}"
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error"]
    command += ["-f", "lavfi", "-i", picture, "-f", "lavfi", "-i", f"sine=duration={min(seconds, 3)}"]
    command += ["-c:v", "libx264", "-preset", "ultrafast", "-pix_fmt", "yuv420p", "-c:a", "aac"]
    command += ["-metadata", "location=+48.2085+016.3721/", "-metadata", f"title={DEVICE}", str(path)]
    subprocess.run(command, check=True)
    return path
