"""Photos in, mesh out, through the real structure from motion."""

import io
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree
from skimage.transform import SimilarityTransform

from dynamictree.errors import CameraSearchError, Cancelled, ReconstructionError
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.formats.splat.ply import read_gaussian_ply
from dynamictree.reconstruct import Callbacks, Progress, ReconstructOptions, cameras, reconstruct
from dynamictree.reconstruct.cameras import find_cameras, pairs_to_match
from dynamictree.reconstruct.optimise import Schedule
from dynamictree.reconstruct.photos import list_photos, prepare_photos
from dynamictree.requests import Reading
from tests.reconstruct.conftest import WIDTH, Orbit

pytestmark = pytest.mark.timeout(600)  # half a minute on two free cores; native code that other work may starve


OPTIONS = ReconstructOptions(schedule=Schedule(num_steps=400, side_px=WIDTH, check_every=100))


@pytest.fixture(scope="module")
def reconstruction(orbit: Orbit, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reconstruction")
    shares: list[float] = []
    listening = Callbacks(on_progress=lambda progress: shares.append(progress.total))
    result = reconstruct(orbit.photos, folder, options=OPTIONS, callbacks=listening)
    return folder, result, shares


@pytest.mark.slow
def test_cameras_and_mesh_are_where_photos_and_thing_were(reconstruction, orbit):
    """The mesh is the thing without its ground."""
    _, result, _ = reconstruction
    assert result.report["num_registered"] >= 12
    assert result.report["reprojection_error_px"] < 1
    number = {path.name: row for row, path in enumerate(orbit.photos)}
    true = np.array([orbit.cameras[number[view.photo]].position_m for view in result.cameras])
    positions = np.array([view.camera.position_m for view in result.cameras])
    moved = SimilarityTransform.from_estimate(positions, true)
    assert np.linalg.norm(moved(positions) - true, axis=1).max() < 0.03
    assert moved.params[2, 2] / moved.scale > np.cos(np.radians(2))  # +Z is up
    assert result.report["ground_found"]
    assert moved.scale == pytest.approx(1.2, rel=0.05)  # the mesh is 1 m high, the stump 1.2 m
    vertices = moved(result.mesh.vertices)
    surface = orbit.stump.vertices[orbit.stump.faces].mean(axis=1)
    near = 0.03 * 1.2
    assert (cKDTree(surface).query(vertices)[0] < near).mean() > 0.9
    assert (cKDTree(vertices).query(surface[surface[:, 2] > 0.06])[0] < near).mean() > 0.85
    assert result.mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-5)
    assert result.mesh.height_m == pytest.approx(1, rel=1e-3)


@pytest.mark.slow
def test_files_hold_what_was_found(reconstruction, orbit):
    folder, result, shares = reconstruction
    names = ["cameras.json", "mesh.ply", "photos.safetensors", "report.json", "report.png", "scene.ply", "splat.ply"]
    assert sorted(path.name for path in folder.iterdir()) == names
    mesh = read_mesh(
        io.BytesIO((folder / "mesh.ply").read_bytes()), file_type="ply", reading=Reading(up_axis="+Z", unit_m=1.0)
    )
    assert np.allclose(mesh.vertices, result.mesh.vertices)
    assert np.array_equal(mesh.look.vertex_colors, result.mesh.look.vertex_colors)
    report = json.loads((folder / "report.json").read_text())
    assert report == result.report
    assert report["scale"] == "unknown"
    assert report["num_registered"] + len(report["left_out"]) == len(orbit.photos)
    cameras = json.loads((folder / "cameras.json").read_text())["cameras"]
    assert [camera["photo"] for camera in cameras] == [view.photo for view in result.cameras]
    for name, cloud in (("splat.ply", result.splat), ("scene.ply", result.scene)):
        read = read_gaussian_ply(io.BytesIO((folder / name).read_bytes()))
        assert np.allclose(read.means, cloud.means, atol=1e-5)
    with Image.open(folder / "report.png") as picture:
        width, height = report["held_out_size_px"]  # undistortion may cut a few pixels off
        assert abs(width - WIDTH) < 5
        # two photos held out, each beside the splat and the mesh; below, the circle of the cameras
        assert picture.size == (3 * width, 2 * height + 640)
    assert shares == sorted(shares)
    assert shares[0] == 0
    assert shares[-1] == 1


@pytest.mark.slow
def test_the_splat_is_the_thing_without_its_ground(reconstruction):
    _, result, _ = reconstruction
    report = result.report
    assert len(report["held_out"]) == 2
    assert not set(report["held_out"]) & set(report["left_out"])
    assert min(report["held_out_psnr_db"]) > 17.5  # 17.7 to 19.5 after 400 steps: they differ with the cameras found
    assert np.mean(report["held_out_psnr_db"]) > np.mean(report["held_out_blank_psnr_db"]) + 6
    assert 300 < result.splat.num_gaussians < result.scene.num_gaussians
    distance = cKDTree(result.mesh.vertices).query(result.splat.means)[0]
    assert distance.max() < 0.1
    assert result.splat.means[:, 2].min() > -0.1


def test_a_callback_ends_the_process_at_once_and_leaves_nothing(orbit, tmp_path):
    def stop(progress: Progress) -> None:
        if progress.stage == "cameras" and progress.share > 0:
            stopped_at.append(time.monotonic())
            raise Cancelled("enough")

    stopped_at: list[float] = []
    with pytest.raises(Cancelled):
        reconstruct(orbit.photos, tmp_path, callbacks=Callbacks(on_progress=stop))
    assert time.monotonic() - stopped_at[0] < 5
    assert list(tmp_path.iterdir()) == []
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
    commands = [Path(f"/proc/{child}/cmdline").read_bytes() for child in children if Path(f"/proc/{child}").exists()]
    assert not any(b"reconstruct.mapping" in command for command in commands)


def test_photos_that_share_nothing_are_reported(tmp_path, rng):
    paths = []
    for number in range(8):
        coarse = rng.integers(0, 255, (30, 40, 3)).astype(np.uint8)
        paths.append(tmp_path / f"{number}.png")
        Image.fromarray(coarse).resize((320, 240), Image.Resampling.BICUBIC).save(paths[-1])
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(ReconstructionError, match=r"^\d of 8 photos fit together; at least 5 must; take sharp photos"):
        reconstruct(paths, out)
    assert list(out.iterdir()) == []


@pytest.mark.slow
def test_masks_of_a_thin_stem_do_not_lose_the_cameras(orbit, tmp_path):
    """What is within the masks is too little to find a camera by; what is around it is enough."""
    mask = np.zeros((300, 400), np.uint8)
    mask[100:200, 198:202] = 255
    (tmp_path / "masks").mkdir()
    photos = [Path(shutil.copy(path, tmp_path)) for path in orbit.photos]
    for photo in photos:
        Image.fromarray(mask).save(tmp_path / "masks" / f"{photo.stem}.png")
    prepared = prepare_photos(list_photos(photos, tmp_path), tmp_path / "work" / "photos")
    model = find_cameras(prepared, tmp_path / "work")
    assert len(model.views) == len(orbit.photos)
    assert all(view.alpha is not None and view.alpha.mean() < 10 for view in model.views)


def test_a_search_that_takes_too_long_is_ended(orbit, tmp_path):
    prepared = prepare_photos(list_photos(orbit.photos), tmp_path / "photos")
    start = time.monotonic()
    with pytest.raises(ReconstructionError, match="took too long"):
        find_cameras(prepared, tmp_path, time_limit_s=0.5)
    assert time.monotonic() - start < 10


def test_a_search_that_dies_tells_why_whatever_its_libraries_write(orbit, tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text("import os; os.write(1, b'BLAS : Bad memory unallocation!\\n')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    prepared = prepare_photos(list_photos(orbit.photos), tmp_path / "photos")
    (tmp_path / "features.db").write_bytes(b"no database" * 100)
    with pytest.raises(CameraSearchError, match="the search for cameras ended with"):
        find_cameras(prepared, tmp_path)


def test_importing_it_loads_no_pycolmap():
    code = "import sys, dynamictree.reconstruct; assert 'pycolmap' not in sys.modules and 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_few_photos_are_all_paired_and_many_form_a_chain():
    assert len(pairs_to_match(20)) == 20 * 19 // 2
    many = pairs_to_match(300)
    assert len(set(many)) == len(many) < 4000
    assert all(first < second for first, second in many)
    assert {(first, first + 1) for first in range(299)} <= set(many)
    assert (0, 256) in many


def test_pairs_are_most_of_a_search_among_many_photos():
    """Three fifths of the time of 36 photos were shown as a third of it."""
    shares: list[float] = []
    line = [sys.executable, "-c", "print('[\"matches\", 1, 1, 0.0, 1.0]')"]
    with subprocess.Popen(line, stdout=subprocess.PIPE) as child:
        cameras._read_messages(child, shares.append, time.monotonic() + 60, cameras.search_seconds(36))
    assert shares[-1] == pytest.approx(0.86, abs=0.03)


@pytest.mark.slow
@pytest.mark.timeout(1800)  # five minutes on two free cores
def test_real_photos_of_a_thing_on_a_carpet(samples, tmp_path):
    photos = sorted((samples / "photos" / "banana").glob("*.JPG"))
    result = reconstruct(photos, tmp_path)
    assert result.report["num_registered"] >= 13
    assert result.report["ground_found"]
    assert result.report["scale"] == "unknown"
    assert result.mesh.height_m == pytest.approx(1.0, rel=1e-3)
    yellow = result.mesh.look.vertex_colors[:, :3].astype(int)
    assert (yellow[:, 0] - yellow[:, 2] > 25).mean() > 0.6  # bananas, not carpet
    length = float(np.ptp(result.mesh.vertices, axis=0).max())
    assert 1.3 < length < 3.0  # length over height
    assert max(result.report["held_out_size_px"]) >= 600
    assert np.mean(result.report["held_out_psnr_db"]) > 22
