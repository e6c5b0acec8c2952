"""A finished reconstruction is cut again: a stem between floor and lamp."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dynamictree.errors import InputError
from dynamictree.formats.mesh.ply import read_ply_mesh
from dynamictree.formats.splat.ply import read_gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.photo_requests import CutParams
from dynamictree.reconstruct.photo_previews import write_photo_previews
from dynamictree.reconstruct.recut import pack_folder, recut, unpack_folder
from dynamictree.reconstruct.views import View
from tests.reconstruct.finished import BOX, NUM_FLOOR, NUM_LAMP, NUM_STEM, write_finished
from tests.reconstruct.planted import potted, stroke_across, write_planted


@pytest.fixture
def finished(tmp_path) -> Path:
    write_finished(tmp_path / "finished")
    return tmp_path / "finished"


def cloud(path: Path) -> GaussianCloud:
    with path.open("rb") as stream:
        return read_gaussian_ply(stream)


def test_only_the_plant_is_left_and_has_the_height_that_is_asked_for(finished: Path, tmp_path) -> None:
    target = tmp_path / "cut"
    target.mkdir()
    capture = recut(finished, target, CutParams(box_m=BOX, height_m=2.5))
    assert capture.mesh.height_m == pytest.approx(2.5, rel=1e-5)
    assert capture.mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-6)
    splat = cloud(target / "splat.ply")
    assert splat.num_gaussians == NUM_STEM
    length = np.ptp(splat.means[:, 2])
    assert 0.93 * 2.5 < length < 2.5  # inside the surface, which is around the Gaussians
    np.testing.assert_allclose(splat.scales, 0.02 * length, rtol=1e-4)  # scales for a stem of 1 m
    assert cloud(target / "scene.ply").num_gaussians == NUM_STEM + NUM_FLOOR + NUM_LAMP
    mesh = read_ply_mesh((target / "mesh.ply").read_bytes(), companions={})
    np.testing.assert_allclose(mesh.vertices, capture.mesh.vertices, atol=1e-6)
    report = json.loads((target / "report.json").read_text())
    assert (report["scale"], report["num_photos"], report["num_gaussians"]) == ("given", 1, NUM_STEM)
    assert report["mesh_by"] == "splat"  # not what the mesh of everything was made of


def test_the_report_shows_the_mesh_that_is_delivered(finished: Path, tmp_path) -> None:
    """The floor was on the picture of a mesh that has none."""
    recut(finished, finished, CutParams(box_m=BOX))
    picture = np.asarray(Image.open(finished / "report.png"))
    photo, splat, mesh = (picture[:120, first : first + 160].astype(int) for first in (0, 160, 320))
    assert np.abs(photo - splat).mean() < 6  # JPEG
    seen = np.abs(mesh - mesh[:, :1]).max(axis=2) > 12  # the background is as bright all along a row
    assert seen.any(axis=1).sum() > 40
    assert seen.any(axis=0).sum() < 12  # a stem, 6 cm wide


@pytest.mark.usefixtures("coarse")
def test_a_plant_that_the_photos_do_not_show_is_refused_unless_someone_marked_it(tmp_path) -> None:
    """8 of 24 photos made black fog, which was delivered as the plant."""
    write_planted(potted(), tmp_path / "finished")
    (tmp_path / "cut").mkdir()
    noise = np.random.default_rng(0).integers(0, 255, (180, 240, 3)).astype(np.uint8)
    views = [View(source=view.photo, image=noise, camera=view.camera) for view in potted().views]
    write_photo_previews(views, tmp_path / "finished")
    with pytest.raises(InputError, match="the splat shows no plant there; draw strokes"):
        recut(tmp_path / "finished", tmp_path / "cut", CutParams(only_plant=True))
    recut(tmp_path / "finished", tmp_path / "cut", CutParams(scribbles=[stroke_across(potted(), 0)]))
    [warning] = json.loads((tmp_path / "cut" / "report.json").read_text())["warnings"]
    assert "the splat shows no plant there" in warning


def test_cameras_look_at_what_they_saw(finished: Path, tmp_path) -> None:
    def directions(folder: Path) -> np.ndarray:
        [camera] = json.loads((folder / "cameras.json").read_text())["cameras"]
        toward = cloud(folder / "scene.ply").means - np.array(camera["position_m"])
        return toward / np.linalg.norm(toward, axis=1, keepdims=True)

    before = directions(finished)
    recut(finished, finished, CutParams(box_m=BOX, height_m=0.7))
    np.testing.assert_allclose(directions(finished), before, atol=1e-5)


def test_a_cut_and_then_a_height_is_both_at_once(finished: Path, tmp_path) -> None:
    for name in ("once", "first", "second"):
        (tmp_path / name).mkdir()
    recut(finished, tmp_path / "once", CutParams(box_m=BOX, height_m=3.0))
    recut(finished, tmp_path / "first", CutParams(box_m=BOX))
    assert json.loads((tmp_path / "first" / "report.json").read_text())["scale"] == "unknown"
    recut(tmp_path / "first", tmp_path / "second", CutParams(height_m=3.0))
    once, twice = (cloud(tmp_path / name / "scene.ply") for name in ("once", "second"))
    np.testing.assert_allclose(twice.means, once.means, atol=1e-5)


@pytest.mark.usefixtures("coarse")
def test_what_the_mesh_lacks_gets_a_surface_of_its_gaussians(finished: Path, tmp_path) -> None:
    capture = recut(finished, finished, CutParams(box_m=((-0.5, -0.5, 1.9), (0.5, 0.5, 2.6))))
    assert capture.mesh.num_faces > 100
    assert capture.cloud.num_gaussians > 0.9 * NUM_LAMP


def test_a_box_of_nothing_and_a_folder_of_something_else_are_refused(finished: Path, tmp_path) -> None:
    with pytest.raises(InputError, match=r"nothing is in box_m"):
        recut(finished, finished, CutParams(box_m=((5.0, 5.0, 5.0), (6.0, 6.0, 6.0))))
    with pytest.raises(InputError, match=r"Gaussians of a plant are in the cut; at least 50"):
        recut(finished, finished, CutParams(box_m=((-0.1, -0.1, 0.5), (0.1, 0.1, 0.6))))
    with pytest.raises(InputError, match=r"holds no report\.json"):
        recut(tmp_path, tmp_path, CutParams())


def test_unpack_undoes_pack(finished: Path, tmp_path) -> None:
    pack_folder(finished, tmp_path / "all.zip")
    unpack_folder(tmp_path / "all.zip", tmp_path / "again")
    names = sorted(path.name for path in finished.iterdir())
    assert sorted(path.name for path in (tmp_path / "again").iterdir()) == names
    assert all((finished / name).read_bytes() == (tmp_path / "again" / name).read_bytes() for name in names)
