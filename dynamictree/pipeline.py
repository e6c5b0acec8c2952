"""The method in a page: photos or splat → mesh → voxels → spectrum → motion and its files. Paper figure 2.

Importing this module loads no torch; the functions that need a network or a picture load what they need.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from jaxtyping import Complex64, UInt8

from dynamictree.devoxelize.length_preserving import length_preserving
from dynamictree.files import Companions, opened
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.formats.source_file import read_capture, source_kind
from dynamictree.formats.suffixes import PHOTO_SUFFIXES
from dynamictree.gaussian.binding import Binding, bind_capture
from dynamictree.gaussian.capture import Capture
from dynamictree.mesh import TriangleMesh
from dynamictree.products import (
    FILE_NAMES,
    PICTURE_FILE_NAMES,
    SPLAT_FILE_NAMES,
    Facts,
    SwayingMesh,
    iter_mesh_pictures,
    phases,
    write_mesh_product,
)
from dynamictree.requests import (
    CLOUD_FORMATS,
    MESH_FORMATS,
    Box,
    ExportParams,
    Format,
    GridParams,
    Resolution,
    Shot,
    Wind,
)
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.splat_products import (
    SwayingSplat,
    iter_splat_pictures,
    lighter_splat,
    sequence_bytes,
    splat_sheet,
    write_splat_product,
)
from dynamictree.voxel.voxelize import SurfaceVoxels
from dynamictree.voxel.voxelize import voxelize as voxelize_surface

if TYPE_CHECKING:
    from dynamictree.models import MotionModel

OnStep = Callable[[int, int], None]
OnProgress = Callable[[float], None]
OnFacts = Callable[[Format, Facts], None]
"""Gets a format, and what its file has to tell of itself."""


def load_mesh(path: Path, *, up_axis: str | None = None, unit_m: float | None = None) -> TriangleMesh:
    """Read a mesh file with the files of its folder that it names (MTL, textures), in metres and +Z up.

    Raises:
        InputError: it cannot be read, or is no mesh that the method can work on.
    """
    with opened(path) as stream:
        file_type = sniff_file_type(stream.read(4096), path.name)
        stream.seek(0)
        return read_mesh(stream, file_type=file_type, up_axis=up_axis, unit_m=unit_m, companions=Companions(path))


def load_capture(
    path: Path,
    *,
    up_axis: str | None = None,
    unit_m: float | None = None,
    mask: Path | None = None,
    mesh: Path | None = None,
) -> Capture:
    """Read a splat or scan, a mask of what may move, and a mesh that lies where the cloud lies.

    Raises:
        InputError: one of them cannot be read, or they do not fit together.
    """
    with ExitStack() as stack:
        stream = stack.enter_context(opened(path))
        _, file_type = source_kind(stream, path.name)
        return read_capture(
            stream,
            file_type=file_type,
            up_axis=up_axis,
            unit_m=unit_m,
            mask=None if mask is None else stack.enter_context(opened(mask)),
            mesh=None if mesh is None else (mesh.name, stack.enter_context(opened(mesh))),
            companions=None if mesh is None else Companions(mesh),
        )


def reconstruct(
    files: Sequence[Path],
    folder: Path,
    on_progress: OnProgress | None = None,
    *,
    root: Path | None = None,
    kept: Path | None = None,
    height_m: float | None = None,
    splat_steps: int | None = None,
    box_m: Box | None = None,
) -> Capture:
    """Photos to cameras, a splat and a mesh of what they show, as files in the folder; gives the splat and the mesh.

    Args:
        files: photos, and what may come with them: masks, `transforms.json`, a COLMAP model, `poses_bounds.npy`.
        folder: for what is made.
        on_progress: gets the share done in [0, 1]; what it raises passes through.
        root: the folder that the files lie in or below, by which they mean one another.
        kept: a folder for what is half done; a second call goes on there.
        height_m: of the tree; without one the mesh is 1 m high.
        splat_steps: how long the splat is learned; by default the schedule's.
        box_m: only what is inside is kept, in the frame of a result without a box.

    Raises:
        InputError: a file is no photo, or there are too few or too many.
        ReconstructionError: the photos do not fit together.
    """
    from dynamictree.reconstruct import ReconstructOptions
    from dynamictree.reconstruct import reconstruct as reconstruct_photos
    from dynamictree.reconstruct.optimise import Schedule

    found = reconstruct_photos(
        [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES],
        folder,
        options=ReconstructOptions(
            height_m=height_m,
            box_m=box_m,
            schedule=Schedule() if splat_steps is None else Schedule(num_steps=splat_steps),
        ),
        root=root,
        work=kept,
        on_progress=lambda progress: on_progress(progress.total) if on_progress else None,
    )
    return Capture(cloud=found.splat, mesh=found.mesh)


def voxelize(mesh: TriangleMesh, *, resolution: Resolution = 128) -> SurfaceVoxels:
    """Occupied voxels of the mesh's surface, with normals. Paper section 3.3."""
    return voxelize_surface(mesh, GridParams(resolution=resolution).resolution)


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
    """Each vertex's share of the voxels' spectrum [m]. Dev(.) of paper eq. 1, smooth and without stretch."""
    return length_preserving(spectrum.grid, mesh).apply(spectrum.coefficients)


def animate(
    mesh: TriangleMesh,
    spectrum: SparseVoxelSpectrum,
    params: ExportParams,
    folder: Path,
    on_progress: OnProgress | None = None,
    *,
    capture: Capture | None = None,
    box_m: Box | None = None,
    on_facts: OnFacts | None = None,
) -> dict[Format, Path]:
    """Write the requested products of one motion into a folder; give their paths by format.

    Where a capture is given, pictures and splats show it; else splats are made from the mesh.
    `on_progress` gets the share done in [0, 1]; what it raises passes through. `on_facts` gets what a product that is
    not exact tells of its error.

    Raises:
        InputError: the frames do not make a loop, though one is asked for; the capture is not where the mesh is;
            or a sequence of splats would be too large.
    """
    formats = params.formats or (MESH_FORMATS if capture is None else CLOUD_FORMATS)
    places = phases(params, spectrum.period_s)
    binding = _binding(mesh, formats, capture, box_m)
    if binding is not None and "splat-ply" in formats:
        sequence_bytes(binding.cloud.num_gaussians, binding.cloud.sh_degree, len(places), params)
    sway = SwayingMesh(
        mesh=mesh,
        coefficients=vertex_spectrum(mesh, spectrum),
        num_frames=spectrum.num_frames,
        loop_fps=spectrum.fps * params.speed,
        phases=places,
        fps=params.fps,
        first_frame=params.first_frame,
        loop=params.loop,
        spectrum=spectrum,
    )
    splat = None if binding is None else lighter_splat(SwayingSplat(binding=binding, sway=sway), params)
    written = _write_products(
        sway, splat, formats, params.shot, folder, on_progress or (lambda done: None), shown=capture is not None
    )
    for name, facts in written.items():
        if facts and on_facts is not None:
            on_facts(name, facts)
    return {name: folder / FILE_NAMES[name] for name in written}


def _binding(
    mesh: TriangleMesh, formats: Sequence[Format], capture: Capture | None, box_m: Box | None
) -> Binding | None:
    """What was captured, hung on the mesh; or Gaussians in the mesh's faces, the same in every run, if asked for."""
    from dynamictree.gaussian.from_mesh import splats_of_mesh

    if capture is not None:
        return bind_capture(capture, mesh, box_m)
    if SPLAT_FILE_NAMES.keys().isdisjoint(formats):
        return None
    return splats_of_mesh(mesh, rng=np.random.default_rng(0)).binding


def _write_products(
    sway: SwayingMesh,
    splat: SwayingSplat | None,
    formats: Sequence[Format],
    shot: Shot,
    folder: Path,
    on_progress: OnProgress,
    *,
    shown: bool,
) -> dict[Format, Facts]:
    facts: dict[Format, Facts] = {name: {} for name in formats}
    paths = {name: folder / FILE_NAMES[name] for name in formats}
    films = [name for name in paths if name in PICTURE_FILE_NAMES and (name != "png" or shown)]
    done = 0

    def report(share: float) -> None:
        on_progress((done + share) / len(paths))

    for name, path in paths.items():
        if name in films:
            continue
        with path.open("wb") as stream:
            if name in SPLAT_FILE_NAMES:
                assert splat is not None
                write_splat_product(name, splat, stream, report)
            elif name == "png":
                _write_sheet(sway, stream)
            else:
                facts[name] = write_mesh_product(name, sway, stream, report)
        done += 1
        report(0.0)
    if films:
        pictures = iter_splat_pictures(splat, shot, report) if splat and shown else None
        _write_films(pictures or iter_mesh_pictures(sway, shot, report), {n: paths[n] for n in films}, sway.fps)
        on_progress(1.0)
    return facts


def _write_films(pictures: Iterator[UInt8[np.ndarray, "H W 3"]], paths: Mapping[Format, Path], fps: float) -> None:
    """Every product that shows the same pictures; they are drawn once."""
    from dynamictree.render import spooled, write_animation, write_png

    with spooled(pictures) as film:
        for name, path in paths.items():
            with path.open("wb") as stream:
                if name == "png":
                    write_png(splat_sheet(film), stream)
                else:
                    write_animation(iter(film), stream, fps=fps, format="webp" if name == "webp" else "mp4")


def _write_sheet(sway: SwayingMesh, stream: BinaryIO) -> None:
    from dynamictree.render import preview_sheet, write_png

    write_png(preview_sheet(sway.mesh, sway.coefficients, num_frames=sway.num_frames), stream)


@lru_cache(maxsize=2)
def _model(preset: str) -> "MotionModel":
    from dynamictree.models import load_model

    return load_model(preset)
