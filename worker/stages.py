"""The four stages of a job. Inputs and outputs are files, so that any worker can continue."""

import json
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import BinaryIO, Protocol, TypeVar

from PIL import Image

from dynamictree import method
from dynamictree.export.table import PRODUCTS
from dynamictree.export.write import Recall, write_products
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.suffixes import PHOTO_SUFFIXES
from dynamictree.formats.tensors.bundle import read_cloud_bundle, read_mesh_bundle, write_bundle
from dynamictree.formats.tensors.spectrum import read_spectrum, write_spectrum
from dynamictree.formats.tensors.voxels import read_voxels, write_voxels
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.capture import Capture, carrying_mesh, only_tree
from dynamictree.plant.choice import with_choice
from dynamictree.plant.trees.of_mesh import only_tree_of
from dynamictree.render.contact_sheet import STRIP_PX
from dynamictree.requests import CloudParams, ExportParams, GridParams, ReconstructParams, SpectrumParams
from jobs.records import Facts, JobRecord
from jobs.states import JobType
from jobs.storage.stage_files import CLOUD_BUNDLE, MESH, MESH_BUNDLE, SPECTRUM, STILL, VOXELS

T = TypeVar("T")


class Report(Protocol):
    """Callback for the progress of a stage."""

    def __call__(self, progress: float, worked_s: float | None = None) -> None:
        """Report the progress in [0, 1] and the time spent so far [s], with that of earlier attempts."""


@dataclass(frozen=True, kw_only=True)
class StageInput:
    """Input of a stage."""

    job: JobRecord
    folder: Path  # empty folder for the stage's files
    resume_dir: Path  # half-done work on the photos on this machine
    files: dict[str, Path]  # files of earlier stages; the asset's mesh as MESH_BUNDLE, or its cloud as CLOUD_BUNDLE
    source_sha256: str  # hash of the file with the shape; empty for photos
    photos: tuple[Path, ...]  # photos, and the cameras and masks that came with them
    recall: Recall  # returns results that other jobs may have computed; for photos, it locks `resume_dir`
    publish: Callable[[Path], None]  # publishes a file as an artifact before the stage has ended
    report: Report  # raises when the stage should stop
    facts: dict[str, Facts] = field(default_factory=dict)  # output: facts about each file, by its name


def reconstruct(given: StageInput) -> Iterable[Path]:
    """Reconstruct a mesh from photos or a cloud."""
    if CLOUD_BUNDLE in given.files:
        return _mesh_of_cloud(given)
    from dynamictree.reconstruct import Callbacks  # slow import, only on demand
    from dynamictree.reconstruct.from_request import reconstruct_capture
    from worker.confined_reading import read_confined, write_confined_frames

    capture = reconstruct_capture(
        given.photos,
        given.folder,
        ReconstructParams.part_of(given.job.params),
        work=given.resume_dir,
        recall=given.recall,
        callbacks=Callbacks(
            read_photos=read_confined,
            write_frames=write_confined_frames,
            on_progress=lambda progress: given.report(progress.total, progress.worked_s),
            on_file=given.publish,
        ),
    )
    assert capture.mesh is not None
    report = json.loads((given.folder / "report.json").read_text())
    given.facts["report.json"] = {"warnings": report["warnings"]}
    _write(capture.mesh, write_bundle, given.folder / MESH_BUNDLE)
    _write(capture, write_bundle, given.folder / CLOUD_BUNDLE)
    return sorted(path for path in given.folder.iterdir() if not path.name.startswith("."))


def _mesh_of_cloud(given: StageInput) -> Iterable[Path]:
    """Write the mesh that came with a cloud, or one of the cloud's moving part."""
    given.report(0.0)
    capture = _capture(given)
    assert capture is not None
    mesh = carrying_mesh(capture, CloudParams.part_of(given.job.params))
    return _write(mesh, write_ply, given.folder / MESH), _write(mesh, write_bundle, given.folder / MESH_BUNDLE)


def voxelize(given: StageInput) -> Iterable[Path]:
    """Voxelize the mesh."""
    given.report(0.0)
    resolution = GridParams.part_of(given.job.params).resolution
    voxels = method.voxelize(_mesh(given), resolution=resolution, source_sha256=given.source_sha256)
    return [_write(voxels, write_voxels, given.folder / VOXELS)]


def diffuse(given: StageInput) -> Iterable[Path]:
    """Generate a spectrum from the voxels."""
    given.report(0.0)
    with given.files[VOXELS].open("rb") as stream:
        voxels = read_voxels(stream)
    params = SpectrumParams.part_of(given.job.params)
    spectrum = method.generate(
        voxels,
        model=given.job.preset,
        seed=given.job.seed,
        of_cloud=CLOUD_BUNDLE in given.files,
        on_step=lambda done, total: given.report(done / total),
        **dict(params),
    )
    return [_write(spectrum, write_spectrum, given.folder / SPECTRUM)]


def animate(given: StageInput) -> Iterable[Path]:
    """Write the motion of a spectrum in the requested formats."""
    given.report(0.0)
    with given.files[SPECTRUM].open("rb") as stream:
        spectrum = read_spectrum(stream)
    choice = CloudParams.part_of(given.job.params)
    if given.photos:  # their box is not in the frame of the scaled mesh
        choice = choice.model_copy(update={"box_m": None})
    paths = write_products(
        _mesh(given, with_source=True),
        spectrum,
        ExportParams.part_of(given.job.params),
        given.folder,
        given.report,
        capture=_capture(given),
        choice=choice,
        on_facts=lambda name, facts: given.facts.update({PRODUCTS[name].file_name: facts}),
        recall=given.recall,
    )
    return [*paths.values(), *(_write_still(path) for name, path in paths.items() if name == "png")]


def _write_still(preview: Path) -> Path:
    """Crop the first of the frames at the bottom of a preview, for lists of jobs."""
    still = preview.with_name(STILL)
    with Image.open(preview) as sheet:
        sheet.crop((0, sheet.height - STRIP_PX[1], STRIP_PX[0], sheet.height)).save(still)
    return still


STAGES: dict[JobType, Callable[[StageInput], Iterable[Path]]] = {
    "reconstruct": reconstruct,
    "voxelize": voxelize,
    "diffuse": diffuse,
    "animate": animate,
}


def _write(product: T, write: Callable[[T, BinaryIO], None], path: Path) -> Path:
    with path.open("xb") as stream:
        write(product, stream)
    return path


def photo_name(index: int, name: str) -> str:
    """Return a relative path for a file that came with photos: its own name, by which cameras and masks refer to it.

    Files that were sent under the same name get separate folders.
    """
    parts = [part for part in PurePosixPath(name.replace("\\", "/")).parts if part not in ("/", ".", "..")]
    safe = [re.sub(r"[^\w.() -]", "_", part)[-100:] for part in parts[-6:]]
    alone = len(safe) < 2 and safe[-1].lower().endswith(PHOTO_SUFFIXES)
    return "/".join([f"{index:04d}" if alone else "all", *safe])


def _capture(given: StageInput) -> Capture | None:
    if CLOUD_BUNDLE not in given.files:
        return None
    with given.files[CLOUD_BUNDLE].open("rb") as stream:
        capture = read_cloud_bundle(stream)
    number = CloudParams.part_of(given.job.params).tree
    return capture if number is None else only_tree(capture, number)


def _mesh(given: StageInput, *, with_source: bool = False) -> TriangleMesh:
    """Read the moving mesh; one made from a cloud or photos already has its still faces."""
    with given.files[MESH_BUNDLE].open("rb") as stream:
        mesh = read_mesh_bundle(stream, with_source=with_source)
    if CLOUD_BUNDLE in given.files:  # the mesh was made of the chosen tree only
        return mesh
    params = CloudParams.part_of(given.job.params)
    chosen = with_choice(mesh, params)
    return chosen if params.tree is None else only_tree_of(chosen, params.tree)
