"""The method in a page: photos → mesh → voxels → spectrum → motion and its files. Paper figure 2, left to right.

Importing this module loads no torch; the functions that need a network or a picture load what they need.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Complex64

from dynamictree.errors import InputError
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.mesh import TriangleMesh
from dynamictree.products import FILE_NAMES, AnimateOptions, SwayingMesh, write_product
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from dynamictree.voxel import devoxelize
from dynamictree.voxel.voxelize import SurfaceVoxels
from dynamictree.voxel.voxelize import voxelize as voxelize_surface

if TYPE_CHECKING:
    from dynamictree.diffusion.model import TreeMotionModel

RESOLUTION = 128  # paper section 5
RESOLUTIONS = (32, 64, 128, 256, 512)
PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png")
COMPANION_SUFFIXES = (".mtl", ".bin", ".png", ".jpg", ".jpeg")

OnStep = Callable[[int, int], None]
OnProgress = Callable[[float], None]


def load_mesh(
    path: Path, *, companions: Mapping[str, Path] | None = None, up_axis: str | None = None, unit_m: float | None = None
) -> TriangleMesh:
    """Read a mesh file with the files that it names (MTL, textures), in metres and +Z up.

    Raises:
        InputError: it cannot be read, or is no mesh that the method can work on.
    """
    beside = {name: other.read_bytes() for name, other in (companions or {}).items()}
    with path.open("rb") as stream:
        file_type = sniff_file_type(stream.read(4096), path.name)
        stream.seek(0)
        return read_mesh(stream, file_type=file_type, up_axis=up_axis, unit_m=unit_m, companions=beside)


def reconstruct(photos: Sequence[Path], folder: Path, on_progress: OnProgress | None = None) -> Path:
    """Find the photos' cameras and a coarse mesh of what they show; gives the mesh's path in the folder.

    Raises:
        InputError: a file is no photo, or there are too few or too many.
        ReconstructionError: the photos do not fit together.
    """
    from dynamictree.reconstruct import reconstruct as reconstruct_photos

    reconstruct_photos(photos, folder, on_progress=on_progress or (lambda done: None))
    return folder / "mesh.ply"


def voxelize(mesh: TriangleMesh, *, resolution: int = RESOLUTION) -> SurfaceVoxels:
    """Occupied voxels of the mesh's surface, with normals. Paper section 3.3."""
    if resolution not in RESOLUTIONS:
        raise InputError(f"resolution is {resolution}; choose from {', '.join(map(str, RESOLUTIONS))}")
    return voxelize_surface(mesh, resolution)


def diffuse(
    voxels: SurfaceVoxels,
    *,
    preset: str = "small",
    seed: int = 0,
    wind: Wind | None = None,
    num_steps: int | None = None,
    on_step: OnStep | None = None,
) -> SparseVoxelSpectrum:
    """Generate the spectrum of a tree's motion from its shape. Paper section 3.4.

    `on_step` gets the sampler steps done and their total; what it raises passes through.
    """
    return _model(preset).generate(voxels, wind=wind or Wind(), seed=seed, num_steps=num_steps, on_step=on_step)


def vertex_spectrum(mesh: TriangleMesh, spectrum: SparseVoxelSpectrum) -> Complex64[np.ndarray, "N K 3"]:
    """Each vertex's share of the voxels' spectrum [m]. Dev(.) of paper eq. 1, smooth."""
    coefficients: Complex64[np.ndarray, "N K 3"] = devoxelize.smooth(spectrum.grid, mesh).apply(spectrum.coefficients)
    return coefficients


def animate(
    mesh: TriangleMesh,
    spectrum: SparseVoxelSpectrum,
    options: AnimateOptions,
    folder: Path,
    on_progress: OnProgress | None = None,
) -> dict[str, Path]:
    """Write the asked products of one motion into a folder; give their paths by format.

    `on_progress` gets the share done in [0, 1]; what it raises passes through.

    Raises:
        InputError: the frames do not make a loop, though one is asked for.
    """
    sway = SwayingMesh(
        mesh=mesh,
        coefficients=vertex_spectrum(mesh, spectrum),
        num_frames=spectrum.num_frames,
        loop_fps=spectrum.fps * options.speed,
        phases=options.phases(spectrum.period_s),
        fps=options.fps,
    )
    paths = {name: folder / FILE_NAMES[name] for name in options.formats}
    for place, (name, path) in enumerate(paths.items()):

        def report(done: float, place: int = place) -> None:
            if on_progress is not None:
                on_progress((place + done) / len(paths))

        with path.open("wb") as stream:
            write_product(name, sway, stream, report)
    return paths


def companions_beside(path: Path) -> dict[str, Path]:
    """Files in a mesh's own folder that it may name, by their names."""
    return {
        other.name: other
        for other in path.parent.iterdir()
        if other.is_file() and other.suffix.lower() in COMPANION_SUFFIXES and other != path
    }


@lru_cache(maxsize=2)
def _model(preset: str) -> "TreeMotionModel":
    from dynamictree.diffusion.model import load_model

    return load_model(preset)
