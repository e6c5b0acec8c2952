"""A folder of photos to cameras, a splat, a coloured mesh and a report."""

import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from dynamictree.errors import InputError, ReconstructionError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.photo_requests import QUALITIES
from dynamictree.reconstruct.camera_circle import camera_circle, coverage_warnings
from dynamictree.reconstruct.cameras import ADVICE, find_cameras
from dynamictree.reconstruct.coloured_mesh import Shape, best_mesh_of, finished_shape
from dynamictree.reconstruct.cut import cloud_in_metres, of_the_tree
from dynamictree.reconstruct.draft import Draft
from dynamictree.reconstruct.exposure import evenly_exposed
from dynamictree.reconstruct.given import files_with_cameras
from dynamictree.reconstruct.markers import Marker, find_markers, metres_per_unit
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.photo_input import ReadPhotos, read_photos
from dynamictree.reconstruct.photos import PhotoFile, list_photos
from dynamictree.reconstruct.progress import OnProgress, Progress, StageClock, ignore_progress
from dynamictree.reconstruct.report import quality_warnings, write_cameras, write_result
from dynamictree.reconstruct.result import MarkerReport, Reconstruction, Report
from dynamictree.reconstruct.scene import find_scene
from dynamictree.reconstruct.splat import SplatFit, fit_splat
from dynamictree.reconstruct.views import SparseModel, read_model
from dynamictree.reconstruct.work_folder import WorkFolder, opened_work

MorePhotos = Callable[[SparseModel], Sequence[Path]]
UNKNOWN_HEIGHT_M = 1.0  # of a mesh whose scale is unknown
_LEAST_GAUSSIANS = 50


@dataclass(frozen=True, kw_only=True)
class ReconstructOptions:
    """Facts about the subject, and how long the splat is learned."""

    height_m: float | None = None  # of the tree; photos alone tell no size
    schedule: Schedule = field(default_factory=Schedule)
    photo_px: int = QUALITIES["standard"].photo_px  # long side to which photos are reduced
    max_views: int = QUALITIES["standard"].max_views  # that depths and splat are made of, evenly chosen

    def __post_init__(self) -> None:
        if self.height_m is not None and not 0 < self.height_m < 1000:
            raise InputError(f"height_m is {self.height_m}; above 0 and below 1000 is allowed")


def reconstruct(
    photos: Sequence[Path],
    folder: Path,
    *,
    options: ReconstructOptions | None = None,
    root: Path | None = None,
    work: Path | None = None,
    more_photos: MorePhotos | None = None,
    read_photos: ReadPhotos = read_photos,
    on_progress: OnProgress = ignore_progress,
    on_file: Callable[[Path], None] = lambda path: None,
) -> Reconstruction:
    """Find cameras, depths, a splat and a mesh, and write each to the folder as soon as it is ready.

    The files are `cameras.json`; `photos.safetensors` (some of the photos, to draw strokes on); `splat.ply` (the tree)
    and `scene.ply` (everything); `mesh.ply`; `report.json` and `report.png`. Without a height, or a marker of
    the sheet in the photos, the mesh is 1 m high and the report calls its scale unknown. Meanwhile `draft.splat` shows
    the splat so far; it is replaced as learning goes on, and deleted at the end.

    Args:
        photos: JPEG, PNG, WebP or TIFF files.
        folder: for the files.
        options: facts about the subject, and how long the splat is learned.
        root: the folder that contains the photos, searched for cameras (`given`) and masks (`photos`).
        work: a folder for the results of finished stages; a later call with the same photos continues there. None:
            nothing is saved.
        more_photos: gets the cameras that were found, and gives all photos to go on with, or none if these suffice.
        read_photos: reads photos and camera files; a service does it in a confined process.
        on_progress: called at least every quarter of a second, except while the mesh is made. An exception in it stops
            the work, ends child processes, and passes through.
        on_file: called with each product as soon as it is complete, and with each draft.

    Raises:
        InputError: too few or too many photos, one that cannot be used, or another process uses `work`.
        ReconstructionError: the photos do not fit together or show no surface.
        CameraSearchError: the program that looks for cameras failed.
    """
    options = options or ReconstructOptions()
    clock, draft = StageClock(on_progress), Draft(folder=folder, on_file=on_file)
    listed = list_photos(photos, root, side_px=options.photo_px)
    with ExitStack() as stack:
        path = work or Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder, prefix="work-")))
        work_folder = opened_work(
            path,
            _sources(listed, root),
            options.schedule,
            photo_px=options.photo_px,
            max_views=options.max_views,
        )
        space = stack.enter_context(work_folder)
        model = _find_cameras(listed, root, space, clock, read_photos)
        if more_photos is not None and (all_photos := more_photos(model)):
            listed = list_photos(all_photos, root, side_px=options.photo_px)
            space.extend(_sources(listed, root))
            model = _find_cameras(listed, root, space, clock, read_photos)
        write_cameras(model.views, folder, scale="unknown")
        on_file(folder / "cameras.json")
        model = evenly_exposed(model)
        with clock.stage("depth") as report:
            scene = find_scene(
                model,
                max_views=options.max_views,
                saved=space.depths,
                on_model=draft.show_points,
                on_progress=report,
            )
        with clock.stage("splat") as report:
            fit = fit_splat(
                scene.matched,
                scene.coarse,
                options.schedule,
                sky=scene.sky,
                saved=space.splat,
                on_progress=report,
                on_table=draft.show,
            )
    with clock.stage("mesh"):
        mesh, mesh_by = best_mesh_of(fit.table, scene, (*fit.held_out, *fit.chosen_by))
        markers = find_markers(scene.model.views)
        unit_m = None if options.height_m else metres_per_unit(markers)
        shape = finished_shape(mesh, scene, height_m=options.height_m or UNKNOWN_HEIGHT_M, unit_m=unit_m)
    origin_of_scale = "given" if options.height_m else "marker" if unit_m else "unknown"
    result = _result(listed, model, fit, shape, markers, clock, mesh_by=mesh_by, scale=origin_of_scale)
    write_result(result, folder)
    draft.delete()
    on_progress(Progress(stage="mesh", share=1.0, total=1.0))
    return result


def _sources(photos: list[PhotoFile], root: Path | None) -> list[Path]:
    """All files that decide on cameras, depths and splat."""
    masks = [photo.mask for photo in photos if photo.mask is not None]
    return [*(photo.path for photo in photos), *masks, *([] if root is None else files_with_cameras(root))]


def _find_cameras(
    photos: list[PhotoFile], root: Path | None, work: WorkFolder, clock: StageClock, read_photos: ReadPhotos
) -> SparseModel:
    """Take cameras from files beside the photos, from an earlier call, or from structure from motion."""
    with clock.stage("photos") as report:
        given, prepared = read_photos(photos, root, work.photos, lambda done, total: report(done / total))
    with clock.stage("cameras") as report:
        model = read_model(work.path, {photo.name: photo.source for photo in prepared})
        return model or find_cameras(prepared, work.path, given=given, on_progress=report)


def own_gaussians(scene: GaussianCloud, shape: Shape) -> Bool[np.ndarray, " G"]:
    """Which Gaussians of the scene are the thing.

    Raises:
        ReconstructionError: next to none, since the cameras are wrong: what they saw fits at no place.
    """
    own = of_the_tree(scene, shape.mesh.vertices, radius_m=shape.scale)
    if own.sum() < _LEAST_GAUSSIANS:
        raise ReconstructionError(
            f"{int(own.sum())} Gaussians lie on the mesh; at least {_LEAST_GAUSSIANS} must; "
            f"the cameras may be wrong; {ADVICE}"
        )
    return own


def _result(
    photos: list[PhotoFile],
    model: SparseModel,
    fit: SplatFit,
    shape: Shape,
    markers: Sequence[Marker],
    clock: StageClock,
    *,
    mesh_by: str,
    scale: str,
) -> Reconstruction:
    whole = cloud_in_metres(fit.table, shape.scale, shape.origin)
    mesh = shape.mesh
    own = own_gaussians(whole, shape)
    cameras = {view.source: view.camera for view in shape.model.views}
    circle = camera_circle(cameras)
    report = Report(
        num_photos=len(photos),
        num_registered=len(shape.model.views),
        left_out=[photo.name for photo in photos if photo.name not in cameras],
        left_out_because=dict(shape.model.left_out),
        reprojection_error_px=model.reprojection_error_px,
        num_points=len(model.points),
        ground_found=shape.ground_found,
        scale=scale,
        markers=[
            MarkerReport(number=marker.number, edge_m=shape.scale * marker.edge, num_photos=marker.num_photos)
            for marker in markers
        ],
        height_m=mesh.height_m,
        radius_m=shape.scale,
        mesh_by=mesh_by,
        num_vertices=mesh.num_vertices,
        num_faces=mesh.num_faces,
        num_gaussians=int(own.sum()),
        num_gaussians_scene=whole.num_gaussians,
        held_out=list(fit.held_out),
        chosen_by=list(fit.chosen_by),
        held_out_psnr_db=[round(value, 2) for value in fit.psnr_db],
        held_out_masked_psnr_db=[round(value, 2) for value in fit.masked_db],
        held_out_ssim=[round(value, 4) for value in fit.ssim],
        held_out_blank_psnr_db=[round(value, 2) for value in fit.blank_db],
        held_out_size_px=list(fit.size_px),
        camera_azimuths_deg=dict(zip(circle.photos, circle.azimuths_deg.round(1).tolist(), strict=True)),
        largest_gap_deg=round(circle.largest_gap_deg, 1),
        beside_largest_gap=list(circle.beside_gap),
        warnings=[
            *coverage_warnings(circle, len(cameras), len(photos)),
            *quality_warnings(fit.psnr_db, fit.blank_db),
        ],
        splat_steps=fit.num_steps,
        num_gaussians_discarded=fit.num_discarded,
        seconds={part: round(taken, 2) for part, taken in clock.seconds.items()},
        processor_seconds={part: round(taken, 2) for part, taken in clock.processor_seconds.items()},
    )
    return Reconstruction(mesh=mesh, splat=whole.subset(own), scene=whole, views=shape.model.views, report=report)
