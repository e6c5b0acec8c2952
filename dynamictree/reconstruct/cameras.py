"""Structure from motion in a child process that is ended when the caller stops."""

import json
import os
import selectors
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from itertools import combinations
from pathlib import Path

from dynamictree.errors import CameraSearchError, ReconstructionError
from dynamictree.reconstruct.input_cameras import InputCamera
from dynamictree.reconstruct.photos import Photo
from dynamictree.reconstruct.views import SparseModel, read_model

_GRACE_S = 3.0  # time between SIGTERM and SIGKILL
_TIME_LIMIT_S = 3600.0

ADVICE = (
    "take sharp photos of a thing that stands still, in even light, from all around, one every 10 to 20 degrees, "
    "so that neighbours share two thirds of what they show"
)


def find_cameras(
    photos: Sequence[Photo],
    folder: Path,
    *,
    given: Sequence[InputCamera] | None = None,
    on_progress: Callable[[float], None] = lambda done: None,
    time_limit_s: float = _TIME_LIMIT_S,
) -> SparseModel:
    """Register the photos in `folder/photos`, or triangulate points for given cameras.

    An exception of the callback ends the process and propagates.

    Raises:
        ReconstructionError: too few photos fit together, or the process took too long.
        CameraSearchError: the process failed.
    """
    min_registered = 5
    cameras = None
    if given is not None:
        of_source = {photo.source: photo for photo in photos}
        pairs = [(camera, of_source[camera.photo]) for camera in given]
        cameras = [camera.scaled(photo.name, photo.width, photo.height).to_json() for camera, photo in pairs]
    job = json.dumps({"folder": str(folder), "photos": [asdict(photo) for photo in photos], "given": cameras})
    (folder / "views.json").unlink(missing_ok=True)  # output of an interrupted search; its features stay
    for name in ("sparse", "chosen", "undistorted", "masks", "undistorted-masks"):  # COLMAP does not overwrite photos
        shutil.rmtree(folder / name, ignore_errors=True)
    command = [sys.executable, "-m", "dynamictree.reconstruct.mapping"]
    with (
        (folder / "mapping.log").open("w+b") as log,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, start_new_session=True
        ) as child,
    ):
        try:
            assert child.stdin is not None
            child.stdin.write(job.encode())
            child.stdin.close()
            _read_messages(child, on_progress, time.monotonic() + time_limit_s, search_seconds(len(photos)))
            child.wait(_GRACE_S)
        finally:
            _end_process_group(child)
        if child.returncode != 0:
            raise CameraSearchError(f"the search for cameras ended with {child.returncode}: {_last_line(log.name)}")
    model = read_model(folder, {photo.name: photo.source for photo in photos})
    registered = len(model.views) if model is not None else 0
    if model is None or registered < min_registered:
        problem = f"{registered} of {len(photos)} photos fit together"
        raise ReconstructionError(f"{problem}; at least {min_registered} must; {ADVICE}")
    return model


def pairs_to_match(number: int) -> list[tuple[int, int]]:
    """List the pairs of photos to match: all pairs of a small set; near and some far pairs of a large, ordered set."""
    next_photos = 8
    exhaustive_up_to = 60  # photos; in a larger set each is matched with the next ones and some at growing distances
    if number <= exhaustive_up_to:
        return list(combinations(range(number), 2))
    steps = [*range(1, next_photos + 1), *(2**power for power in range(4, number.bit_length()))]
    return sorted({(i, i + step) for step in steps for i in range(number - step)})


def search_seconds(num_photos: int) -> dict[str, float]:
    """Estimate the processor seconds of each step, in order; measured in logs of searches with 14 to 36 photos."""
    return {
        "features": 1.0 * num_photos,
        "matches": 0.13 * len(pairs_to_match(num_photos)),
        "cameras": 0.5 * num_photos,
        "undistort": 0.05 * num_photos,
    }


def _read_messages(
    child: subprocess.Popen[bytes], on_progress: Callable[[float], None], until_s: float, expected_s: dict[str, float]
) -> None:
    listen_s = 0.25  # time between two calls of the caller's progress function
    assert child.stdout is not None
    done = 0.0
    with selectors.DefaultSelector() as selector:
        selector.register(child.stdout, selectors.EVENT_READ)
        while True:
            on_progress(done)
            if time.monotonic() > until_s:
                raise ReconstructionError(f"the search for cameras took too long; give fewer photos, or {ADVICE}")
            if not selector.select(listen_s):
                continue
            line = child.stdout.readline()
            if not line:
                return
            if line.startswith(b"["):  # native libraries such as OpenBLAS write to stdout too
                step, part, total, first, last = json.loads(line)
                before_s = sum(list(expected_s.values())[: list(expected_s).index(step)])
                share = (before_s + expected_s[step] * part / total) / sum(expected_s.values())
                done = max(done, first + (last - first) * share)


def _end_process_group(child: subprocess.Popen[bytes]) -> None:
    """End the process group: SIGTERM, and SIGKILL after a grace period."""
    for signal_number in (signal.SIGTERM, signal.SIGKILL):
        if child.poll() is not None:
            return
        os.killpg(child.pid, signal_number)
        with suppress(subprocess.TimeoutExpired):
            child.wait(_GRACE_S)


def _last_line(log: str) -> str:
    lines = Path(log).read_text(errors="replace").strip().splitlines()
    return lines[-1][-300:] if lines else "it wrote no reason"
