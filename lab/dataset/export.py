"""One tree of the dataset as files that other programs open: GLB, PLY sequence, USD."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.motion.ply_sequence import iter_ply_sequence_zip
from dynamictree.formats.motion.usd import write_motion_usdz
from dynamictree.spectrum import FPS, NUM_FRAMES, iter_motion
from lab.dataset.sample import Sample


def export_sample(sample: Sample, name: str, folder: Path) -> Path:
    """Write a tree in one of the `EXPORTS`, and give the file's path."""
    ending, write = EXPORTS[name]
    path = folder / f"4dtree-{sample.seed:07d}{ending}"
    unfinished = path.with_name(f".{path.name}")
    write(sample, unfinished)
    unfinished.replace(path)
    return path


def _write_glb(sample: Sample, path: Path) -> None:
    with path.open("wb") as stream:
        write_motion_glb(sample.mesh, sample.coefficients, stream)


def _write_ply(sample: Sample, path: Path) -> None:
    with path.open("wb") as stream:
        for piece in iter_ply_sequence_zip(sample.mesh, _frames(sample)):
            stream.write(piece)


def _write_usd(sample: Sample, path: Path) -> None:
    with path.open("wb") as stream:
        write_motion_usdz(sample.mesh, _frames(sample), stream, fps=FPS)


def _frames(sample: Sample) -> Iterator[Float32[np.ndarray, "N 3"]]:
    return iter_motion(sample.coefficients, np.arange(NUM_FRAMES) / NUM_FRAMES)


EXPORTS: dict[str, tuple[str, Callable[[Sample, Path], None]]] = {
    "glb": (".glb", _write_glb),
    "ply": (".ply.zip", _write_ply),
    "usd": (".usdz", _write_usd),
}
"""File ending and writer of each format."""
