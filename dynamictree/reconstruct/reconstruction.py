"""Reconstruct cameras, a splat, a coloured mesh and a report from photos or a film."""

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from dynamictree.errors import ReconstructionError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.memory import return_freed_memory
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.camera_circle import camera_circle, coverage_warnings
from dynamictree.reconstruct.cameras import ADVICE, find_cameras
from dynamictree.reconstruct.coloured_mesh import best_mesh_of
from dynamictree.reconstruct.draft import Draft, OnFile
from dynamictree.reconstruct.exposure import equalise_exposure
from dynamictree.reconstruct.film_photos import Film, FilmPhotos, WriteFrames, write_sharp_frames
from dynamictree.reconstruct.input_cameras import files_with_cameras
from dynamictree.reconstruct.markers import metres_per_unit
from dynamictree.reconstruct.options import ReconstructOptions
from dynamictree.reconstruct.photo_cameras import write_cameras
from dynamictree.reconstruct.photo_previews import write_photo_previews
from dynamictree.reconstruct.photos import PhotoFile, ReadPhotos, list_photos, read_photos
from dynamictree.reconstruct.progress import OnProgress, Progress, StageClock, expected_seconds
from dynamictree.reconstruct.report import photos_to_compare, quality_warnings, write_report_picture
from dynamictree.reconstruct.result import MarkerReport, Reconstruction, Report
from dynamictree.reconstruct.scene import Scene, find_scene
from dynamictree.reconstruct.splat import SplatFit, fit_splat
from dynamictree.reconstruct.splat_state import SplatState
from dynamictree.reconstruct.splat_table import cloud_of
from dynamictree.reconstruct.surface_choice import gaussians_near_mesh
from dynamictree.reconstruct.views import SparseModel, read_model
from dynamictree.reconstruct.work_folder import DEPTHS, PHOTOS, SPLAT, TIMES, extend_work, locked_work_folder

_LEAST_GAUSSIANS = 50


@dataclass(frozen=True, kw_only=True)
class Callbacks:
    """Readers of files, and listeners; the service reads files in sandboxed processes."""

    read_photos: ReadPhotos = read_photos
    write_frames: WriteFrames = write_sharp_frames
    on_progress: OnProgress = lambda progress: None  # its exceptions end child processes and propagate
    on_file: OnFile = lambda path: None  # called with each complete product and each draft


def reconstruct(
    photos: Sequence[Path] | Film,
    folder: Path,
    *,
    options: ReconstructOptions | None = None,
    root: Path | None = None,
    work: Path | None = None,
    callbacks: Callbacks | None = None,
) -> Reconstruction:
    """Reconstruct cameras, depths, a splat and a mesh, and write each to the folder as soon as it is complete.

    The files are `cameras.json`; `photos.safetensors` (photos to draw strokes on); `splat.ply` (the tree)
    and `scene.ply` (everything); `mesh.ply`; `report.json` and `report.png`. Without a marker of the sheet in the
    photos, the mesh is 1 m high and the report calls its scale unknown. During the work `draft.splat` shows
    the current splat; it is replaced at intervals, and deleted at the end.

    Args:
        photos: JPEG, PNG, WebP, TIFF or HEIC files, or a film.
        folder: folder for the files.
        options: resolution and number of photos, and schedule of the optimisation.
        root: folder that contains the photos, searched for files with cameras and for masks.
        work: folder for the results of finished stages, from which a later call with the same photos continues; if
            None, nothing is saved.
        callbacks: readers of files, and listeners.

    Raises:
        InputError: there are too few or too many photos, one cannot be used, or another process uses `work`.
        ReconstructionError: the photos do not fit together or show no surface.
        CameraSearchError: the process of structure from motion failed.
    """
    unknown_height_m = 1.0  # height of a mesh whose scale is unknown
    options, callbacks = options or ReconstructOptions(), callbacks or Callbacks()
    draft = Draft(folder=folder, on_file=callbacks.on_file)
    latest = Progress(stage="photos", share=0.0, total=0.0)

    def on_progress(progress: Progress) -> None:
        nonlocal latest
        latest = progress
        callbacks.on_progress(progress)

    with ExitStack() as stack:
        path = work or Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder, prefix="work-")))
        frames = None
        if isinstance(photos, Film):
            frames = FilmPhotos(
                film=photos,
                folder=path / f"frames-{photos.count}-{photos.path.stat().st_size}",
                on_work=lambda: callbacks.on_progress(latest),
                write_frames=callbacks.write_frames,
            )
            photos, root = frames.first(), frames.folder
        listed = list_photos(photos, root, side_px=options.photo_px)
        stack.enter_context(locked_work_folder(path, _sources(listed, root), options))
        expected_s = expected_seconds(len(listed), options)
        half = 1.0 if frames is None else 0.5  # a film's cameras are searched twice, the second time with more frames
        expected_s["cameras"] /= half
        clock = StageClock(on_progress, expected_s, path / TIMES)
        model = _find_cameras(listed, root, path, clock, callbacks.read_photos, part=(0.0, half))
        if frames is not None and (more := frames.more(model)):
            listed = list_photos(more, root, side_px=options.photo_px)
            extend_work(path, _sources(listed, root), options)
            model = _find_cameras(listed, root, path, clock, callbacks.read_photos, part=(half, 1.0))
        write_cameras([view.photo_camera for view in model.views], folder, scale="unknown")
        callbacks.on_file(folder / "cameras.json")
        model = equalise_exposure(model)
        with clock.stage("depth") as report:
            scene = find_scene(
                model, max_views=options.max_views, saved=path / DEPTHS, on_model=draft.show_points, on_progress=report
            )
        with clock.stage("splat") as report:

            def on_state(state: SplatState) -> None:
                psnr_db = float(state.checks[-1, 2]) if len(state.checks) else None
                report(state.step / options.schedule.num_steps, psnr_db)
                draft.show(state)

            fit = fit_splat(
                scene.matched, scene.depths, options.schedule, sky=scene.sky, saved=path / SPLAT, on_state=on_state
            )
        scene = replace(scene, sky=None)  # hundreds of megabytes that the mesh does not need
        return_freed_memory()  # memory of the photos at the sizes of the optimisation
        with clock.stage("mesh"):
            cloud = cloud_of(fit.table)
            mesh, mesh_by = best_mesh_of(fit.table, scene, fit.figures["held_out"])
            unit_m = metres_per_unit(scene.model.markers)
            result = Reconstruction(
                mesh=mesh,
                scene=cloud,
                own=own_gaussians(cloud, mesh),
                cameras=[view.photo_camera for view in scene.model.views],
                report=_report(fit, scene, mesh_by, [photo.name for photo in listed]),
            )
            middle = np.median(mesh.vertices, axis=0).astype(np.float64)
            ground = np.array([middle[0], middle[1], mesh.vertices[:, 2].min()])
            result = result.moved(unit_m or unknown_height_m / mesh.height_m, ground)
    result.report["seconds"] = {part: round(taken, 2) for part, taken in clock.seconds.items()}
    result.report["processor_seconds"] = {part: round(taken, 2) for part, taken in clock.processor_seconds.items()}
    result.write(folder)
    write_photo_previews(scene.model.views, folder, needed=photos_to_compare(result.report["held_out"]))
    write_report_picture(result, folder)
    draft.delete()
    worked_s = sum(clock.seconds.values())
    callbacks.on_progress(Progress(stage="mesh", share=1.0, total=1.0, worked_s=worked_s))
    return result


def _sources(photos: list[PhotoFile], root: Path | None) -> list[Path]:
    """List all files that determine cameras, depths and splat."""
    masks = [photo.mask for photo in photos if photo.mask is not None]
    return [*(photo.path for photo in photos), *masks, *([] if root is None else files_with_cameras(root))]


def _find_cameras(
    photos: list[PhotoFile],
    root: Path | None,
    work: Path,
    clock: StageClock,
    read_photos: ReadPhotos,
    *,
    part: tuple[float, float],
) -> SparseModel:
    """Read given or saved cameras, or run structure from motion, whose progress fills the interval `part` of [0, 1]."""
    first, last = part
    with clock.stage("photos") as report:
        given, prepared = read_photos(photos, root, work / PHOTOS, lambda done, total: report(done / total))
    with clock.stage("cameras") as report:
        model = read_model(work, {photo.name: photo.source for photo in prepared})
        return model or find_cameras(
            prepared, work, given=given, on_progress=lambda share: report(first + (last - first) * share)
        )


def own_gaussians(scene: GaussianCloud, mesh: TriangleMesh) -> Bool[np.ndarray, " G"]:
    """Return a mask of the Gaussians that belong to the mesh, in the upright frame.

    Raises:
        ReconstructionError: there are too few, which means that the cameras are wrong.
    """
    own = gaussians_near_mesh(scene, mesh, radius=1.0)
    if own.sum() < _LEAST_GAUSSIANS:
        raise ReconstructionError(
            f"{int(own.sum())} Gaussians lie on the mesh; at least {_LEAST_GAUSSIANS} must; "
            f"the cameras may be wrong; {ADVICE}"
        )
    return own


def _report(fit: SplatFit, scene: Scene, mesh_by: str, photos: list[str]) -> Report:
    """Create the report in the upright frame, without times and the sizes that `Reconstruction.write` adds."""
    model, figures = scene.model, fit.figures
    cameras = {view.source: view.camera for view in model.views}
    circle = camera_circle(cameras)
    return Report(
        **figures,
        num_photos=len(photos),
        num_registered=len(model.views),
        left_out=[photo for photo in photos if photo not in cameras],
        left_out_because=dict(model.left_out),
        reprojection_error_px=model.reprojection_error_px,
        num_points=len(model.points),
        ground_found=scene.ground_found,
        scale="marker" if metres_per_unit(model.markers) else "unknown",
        markers=[MarkerReport(number=one.number, edge_m=one.edge, num_photos=one.num_photos) for one in model.markers],
        height_m=0.0,
        radius_m=1.0,
        mesh_by=mesh_by,
        num_vertices=0,
        num_faces=0,
        num_gaussians=0,
        num_gaussians_scene=0,
        camera_azimuths_deg=dict(zip(circle.photos, circle.azimuths_deg.round(1).tolist(), strict=True)),
        largest_gap_deg=round(circle.largest_gap_deg, 1),
        beside_largest_gap=list(circle.beside_gap),
        warnings=[
            *coverage_warnings(circle, len(cameras), len(photos)),
            *quality_warnings(figures["held_out_psnr_db"], figures["held_out_blank_psnr_db"]),
        ],
        seconds={},
        processor_seconds={},
        plant_psnr_db=None,
        without_plant_psnr_db=None,
        plant_blank_psnr_db=None,
    )
