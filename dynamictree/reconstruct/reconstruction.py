"""A folder of photos in; cameras, a splat, a coloured mesh and a report out."""

import resource
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from dynamictree.errors import InputError, ReconstructionError
from dynamictree.gaussian.cloud import GaussianCloud, in_box
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.cameras import find_cameras
from dynamictree.reconstruct.cut import cloud_in_metres, of_the_tree
from dynamictree.reconstruct.given import GivenCamera, find_given, fits
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.photos import PhotoFile, list_photos, prepare_photos, sizes_of
from dynamictree.reconstruct.report import Report, quality_warnings, write_cameras, write_report
from dynamictree.reconstruct.splat import SplatFit, fit_splat
from dynamictree.reconstruct.surface import Shape, best_surface, find_scene, finished
from dynamictree.reconstruct.views import SparseModel, View, read_model

UNKNOWN_HEIGHT_M = 1.0  # what photos alone cannot tell
_PREPARED, _MAPPED, _MATCHED, _LEARNED = 0.03, 0.3, 0.45, 0.95  # shares of the whole
_LEAST_GAUSSIANS = 50

OnProgress = Callable[[float], None]


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions:
    """What is known of the photos, and how much work is put in."""

    height_m: float | None = None  # of the tree; photos alone tell no size
    box_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None  # only what is inside is kept
    schedule: Schedule = field(default_factory=Schedule)

    def __post_init__(self) -> None:
        if self.height_m is not None and not 0 < self.height_m < 1000:
            raise InputError(f"height_m is {self.height_m}; above 0 and below 1000 is allowed")


@dataclass(frozen=True, kw_only=True)
class Reconstruction:
    """The tree as mesh and as splat, its scene, its cameras, and how it went; metres, +Z up, on the ground."""

    mesh: TriangleMesh
    splat: GaussianCloud
    scene: GaussianCloud
    views: tuple[View, ...]
    report: Report


def reconstruct(
    photos: Sequence[Path],
    folder: Path,
    *,
    options: ReconstructOptions | None = None,
    root: Path | None = None,
    kept: Path | None = None,
    on_progress: OnProgress = lambda done: None,
) -> Reconstruction:
    """Find cameras, depths, a splat and a mesh, and write each into the folder as soon as it is there.

    `cameras.json`; `splat.ply` (the tree) and `scene.ply` (all); `mesh.ply`; `report.json` and `report.png`. Without
    a height the mesh is 1 m high and the report calls its scale unknown. The callback gets the share that is done,
    every quarter of a second while cameras are sought and before every photo and every step otherwise; what it raises
    stops the work, leaves no process, and passes through.

    Args:
        photos: JPEG, PNG, WebP or TIFF files.
        folder: for what is made.
        options: what is known, and how much work is put in.
        root: the folder that the photos lie in or below, where cameras (`given`) and masks (`photos`) are looked for.
        kept: a folder for what is half done; a second call with the same goes on there. None: nothing is kept.
        on_progress: see above.

    Raises:
        InputError: too few or too many photos, or one that cannot be used.
        ReconstructionError: the photos do not fit together or show no surface.
    """
    options = options or ReconstructOptions()
    spent = _Spent()
    with ExitStack() as stack:
        work = kept or Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder, prefix="work-")))
        listed = list_photos(photos, root)
        model = _cameras(listed, root, work, spent, on_progress)
        write_cameras(model.views, folder, scale="unknown")
        with spent.on("depth"):
            scene = find_scene(model, on_progress=_within(on_progress, _MAPPED, _MATCHED))
        with spent.on("splat"):
            fit = fit_splat(
                scene.matched,
                scene.coarse,
                options.schedule,
                saved=work / "splat.npz",
                on_progress=_within(on_progress, _MATCHED, _LEARNED),
            )
    with spent.on("mesh"):
        surface, made_by = best_surface(fit.table, scene)
        shape = finished(surface, scene, height_m=options.height_m or UNKNOWN_HEIGHT_M)
    found = _put_together(listed, model, fit, shape, options, spent, mesh_by=made_by)
    write_report(found, fit, folder)
    on_progress(1.0)
    return found


def _cameras(
    photos: list[PhotoFile], root: Path | None, work: Path, spent: "_Spent", on_progress: OnProgress
) -> SparseModel:
    """From what is given, from what an earlier call has found, or from the photos."""
    with spent.on("photos"):
        given = None if root is None else _given(photos, root)
        if given is not None:
            known = {camera.photo: camera for camera in given}
            photos = [_as_given(photo, known[photo.name]) for photo in photos if photo.name in known]
        prepared = prepare_photos(photos, work / "photos", on_photo=_counted(_within(on_progress, 0.0, _PREPARED)))
    with spent.on("cameras"):
        found = read_model(work, {photo.name: photo.source for photo in prepared})
        within = _within(on_progress, _PREPARED, _MAPPED)
        return found or find_cameras(prepared, work, given=given, on_progress=within)


def _given(photos: list[PhotoFile], root: Path) -> tuple[GivenCamera, ...] | None:
    return find_given(root, {photo.name: sizes_of(photo) for photo in sorted(photos, key=lambda photo: photo.name)})


def _as_given(photo: PhotoFile, camera: GivenCamera) -> PhotoFile:
    """Turned upright only if that is how the given camera saw it: some programs heed EXIF and some do not."""
    stored, _ = sizes_of(photo)
    return replace(photo, as_stored=fits(camera, stored))


def _put_together(
    photos: list[PhotoFile],
    model: SparseModel,
    fit: SplatFit,
    shape: Shape,
    options: ReconstructOptions,
    spent: "_Spent",
    *,
    mesh_by: str,
) -> Reconstruction:
    whole = cloud_in_metres(fit.table, shape.scale, shape.origin)
    own = of_the_tree(whole, shape.mesh.vertices, radius_m=shape.scale)
    mesh = shape.mesh
    if options.box_m is not None:
        own &= in_box(whole, *options.box_m)
        mesh = _in_box(mesh, options.box_m)
    if own.sum() < _LEAST_GAUSSIANS:
        raise ReconstructionError(
            f"{int(own.sum())} Gaussians lie on the mesh; at least {_LEAST_GAUSSIANS} must; take photos from nearer"
        )
    registered = {view.source for view in shape.model.views}
    report = Report(
        num_photos=len(photos),
        num_registered=len(shape.model.views),
        left_out=[photo.name for photo in photos if photo.name not in registered],
        reprojection_error_px=model.reprojection_error_px,
        num_points=len(model.points),
        ground_found=shape.ground_found,
        scale="unknown" if options.height_m is None else "given",
        height_m=mesh.height_m,
        mesh_by=mesh_by,
        num_vertices=mesh.num_vertices,
        num_faces=mesh.num_faces,
        num_gaussians=int(own.sum()),
        num_gaussians_scene=whole.num_gaussians,
        held_out=list(fit.held_out),
        held_out_psnr_db=[round(value, 2) for value in fit.psnr_db],
        held_out_blank_psnr_db=[round(value, 2) for value in fit.blank_db],
        held_out_size_px=list(fit.size_px),
        warnings=quality_warnings(fit.psnr_db, fit.blank_db),
        splat_steps=fit.num_steps,
        num_gaussians_discarded=fit.num_discarded,
        seconds={part: round(taken, 2) for part, taken in spent.seconds.items()},
        processor_seconds={part: round(taken, 2) for part, taken in spent.processor_seconds.items()},
    )
    return Reconstruction(mesh=mesh, splat=whole.subset(own), scene=whole, views=shape.model.views, report=report)


def _in_box(mesh: TriangleMesh, box_m: tuple[tuple[float, float, float], tuple[float, float, float]]) -> TriangleMesh:
    low, high = np.array(box_m)
    inside: Bool[np.ndarray, " N"] = np.all((mesh.vertices >= low) & (mesh.vertices <= high), axis=1)
    faces = mesh.faces[inside[mesh.faces].all(axis=1)]
    if len(faces) == 0:
        raise InputError(f"no triangle is in the box from {box_m[0]} to {box_m[1]}; enlarge it")
    used, rows = np.unique(faces, return_inverse=True)
    colors = None if mesh.vertex_colors is None else mesh.vertex_colors[used]
    return replace(mesh, vertices=mesh.vertices[used], faces=rows.reshape(-1, 3).astype(np.int32), vertex_colors=colors)


def _within(on_progress: OnProgress, first: float, end: float) -> OnProgress:
    """A part's own share, as the share of the whole."""
    return lambda done: on_progress(first + (end - first) * done)


def _counted(on_progress: OnProgress) -> Callable[[int, int], None]:
    return lambda done, total: on_progress(done / total)


class _Spent:
    """Time by part [s]: the clock's, and the processor's in this process and those that it has ended."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.processor_seconds: dict[str, float] = {}

    @contextmanager
    def on(self, part: str) -> Iterator[None]:
        start, processor = time.perf_counter(), _processor_s()
        yield
        self.seconds[part] = time.perf_counter() - start
        self.processor_seconds[part] = _processor_s() - processor


def _processor_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
