"""A second job on the same photos, with a box and a height, learns nothing again."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from io import BytesIO
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import PIL.Image
import pytest
import safetensors.numpy
from PIL import Image

from dynamictree.errors import ReconstructionError
from dynamictree.formats.splat.ply import read_gaussian_ply
from dynamictree.formats.tensors.bundle import read_mesh_bundle
from dynamictree.reconstruct.recut import pack_folder
from jobs.records import AssetRecord, JobRecord
from jobs.states import stages_of
from jobs.storage.stage_files import MESH_BUNDLE
from tests.reconstruct.finished import BOX, NUM_STEM, write_finished
from tests.reconstruct.planted import potted, stroke_across, write_planted
from tests.rows import job_row
from tests.worker.conftest import hold, watch
from tests.worker.test_attempt import content as bytes_of
from tests.worker.test_attempt import run
from tests.worker.test_half_done import add_photos, reconstruct_job
from worker.attempt import Attempt
from worker.runtime import Runtime


@pytest.fixture
def photos(runtime: Runtime, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AssetRecord:
    """Eight photos of noise, of which nobody learns anything; surfaces are coarse."""
    monkeypatch.setattr("dynamictree.reconstruct.coloured_mesh.CELLS", 96)
    paths = [tmp_path / f"{number}.png" for number in range(8)]
    for number, path in enumerate(paths):
        Image.effect_noise((400, 300), 10 + number).convert("RGB").save(path)
    return add_photos(runtime, paths)


def test_a_job_decodes_no_photo_itself(runtime: Runtime, photos: AssetRecord, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, open_image = [], PIL.Image.open

    def opening(path: Path, **options: object) -> Image.Image:
        opened.append(Path(path).suffix)
        return open_image(path, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(PIL.Image, "open", opening)
    noise = Mock(side_effect=ReconstructionError("noise"))
    monkeypatch.setattr("dynamictree.reconstruct.reconstruction.find_cameras", noise)
    with pytest.raises(ReconstructionError, match="noise"):
        run(runtime, hold(runtime, reconstruct_job(runtime, photos)))
    assert ".png" not in opened  # the child writes JPEG


def remember(
    runtime: Runtime, photos: AssetRecord, job: JobRecord, folder: Path, make: Callable[[Path], None] | None = None
) -> AssetRecord:
    """As if the job had learned what is in the folder `finished`."""
    watching = watch(runtime, hold(runtime, job))
    attempt = Attempt(runtime=runtime, watch=watching, folder=folder, asset=photos)
    attempt.fetch()
    attempt.recall("reconstruct", folder, "reconstruction", make or partial(pack_folder, folder / "finished"))
    return photos


@pytest.fixture
def learned(runtime: Runtime, photos: AssetRecord, tmp_path: Path) -> AssetRecord:
    """The same, as if a job had learned stem, floor and lamp from them."""
    write_finished(tmp_path / "finished")
    job = reconstruct_job(runtime, photos, height_m=9.0)
    return remember(runtime, photos, job, tmp_path)


@pytest.fixture
def learned_potted(runtime: Runtime, photos: AssetRecord, tmp_path: Path) -> AssetRecord:
    """The same, as if a job had learned a potted plant from them."""
    write_planted(potted(), tmp_path / "finished")
    return remember(runtime, photos, reconstruct_job(runtime, photos, height_m=9.0), tmp_path)


def content(runtime: Runtime, job: JobRecord, name: str) -> BytesIO:
    return BytesIO(bytes_of(runtime, job.id, name))


def test_a_box_and_a_height_cut_what_was_learned(runtime: Runtime, learned: AssetRecord) -> None:
    box = (2.0 / 1.3 * np.array(BOX)).tolist()  # the mesh is 1.3 m high, floor and all, and 2 m without a box
    job = reconstruct_job(runtime, learned, height_m=2.0, box_m=box)
    run(runtime, hold(runtime, job))
    assert read_gaussian_ply(content(runtime, job, "splat.ply")).num_gaussians == NUM_STEM
    mesh = read_mesh_bundle(content(runtime, job, MESH_BUNDLE))
    np.testing.assert_allclose([mesh.vertices[:, 2].min(), mesh.height_m], [0, 2.0], atol=1e-5)
    facts = {artifact.name: artifact.facts for artifact in runtime.store.artifacts_of(job.id)}
    assert facts["report.json"] == {"warnings": []}


def test_a_stroke_cuts_what_was_learned(runtime: Runtime, learned_potted: AssetRecord) -> None:
    stroke = stroke_across(potted(), 0).model_dump(mode="json")
    job = reconstruct_job(runtime, learned_potted, height_m=2.0, scribbles=[stroke])
    run(runtime, hold(runtime, job))
    splat = read_gaussian_ply(content(runtime, job, "splat.ply"))
    number = int(potted().plant.sum())
    assert 0.95 * number < splat.num_gaussians <= number
    assert read_mesh_bundle(content(runtime, job, MESH_BUNDLE)).height_m == pytest.approx(2.0, rel=0.02)


def test_all_that_was_cut_out_moves(runtime: Runtime, learned: AssetRecord) -> None:
    """The box is in the frame of before the cut: afterwards it holds a part of the plant only."""
    box = (2.0 / 1.3 * np.array(BOX)).tolist()
    params = {"height_m": 2.0, "box_m": box, "num_steps": 1, "formats": ["splat"]}
    job = job_row(learned, "animate", now=runtime.store.clock(), params=params)
    job = runtime.store.add_job(job, stages=stages_of("animate", "photos"))[0]
    run(runtime, hold(runtime, job))
    tensors = safetensors.numpy.load(content(runtime, job, "tree.animated-splat.safetensors").getvalue())
    assert len(tensors["face_of"]) == NUM_STEM
    assert (tensors["face_of"] >= 0).all()


def test_other_training_learns_again(runtime: Runtime, learned: AssetRecord, tmp_path: Path) -> None:
    def learn(_: Path) -> None:
        raise ReconstructionError("learned again")

    for params, again in (
        ({"height_m": 1.0}, nullcontext()),
        ({"splat_steps": 100}, pytest.raises(ReconstructionError)),
    ):
        folder = tmp_path / next(iter(params))
        folder.mkdir()
        with again:
            remember(runtime, learned, reconstruct_job(runtime, learned, **params), folder, learn)
