"""Jobs on a splat, in this process, on the real store and the real stages."""

import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dynamictree.formats.cloud_file import read_cloud
from dynamictree.formats.tensors.bundle import read_mesh_bundle, write_bundle
from dynamictree.plant.capture import Capture
from jobs.records import AssetRecord
from jobs.states import JobState
from jobs.storage.assets import add_asset
from tests.formats.meshes import written
from tests.formats.stored import animated_splat
from tests.rows import asset_row, stored_part
from tests.service.test_clouds import post_cloud
from tests.worker.conftest import add_job, hold, wedge
from tests.worker.test_attempt import content, run, with_spectrum
from worker.runtime import Runtime


def keep(runtime: Runtime, capture: Capture, path: Path) -> AssetRecord:
    path.write_bytes(written(write_bundle, capture))
    row = asset_row(stored_part(runtime.artifacts, path), now=runtime.store.clock(), kind="cloud")
    return add_asset(runtime.store, row)[0]


@pytest.fixture
def scene(runtime: Runtime, tmp_path: Path) -> AssetRecord:
    """A post at the origin, and another five metres away."""
    cloud = post_cloud(600)
    means = cloud.means.copy()
    means[400:, 0] += 5
    capture = Capture(cloud=replace(cloud, means=means), mask=np.arange(600) < 400)
    return keep(runtime, capture, tmp_path / "cloud.safetensors")


def test_a_splat_comes_out_moving_and_what_is_around_it_stays(runtime, scene, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("dynamictree.gaussian.cloud_mesh.MAX_FACES", 400)  # enough for the post
    options = {
        "num_frames": 6,
        "fps": 2.4,
        "loop": False,
        "shot": {"side_px": 64},
        "formats": ["splat-ply", "splat", "png"],
    }
    lease = with_spectrum(runtime, scene, tmp_path, **options)
    run(runtime, lease)
    assert runtime.store.job(lease.job.id).state == JobState.SUCCEEDED
    artifacts = {artifact.name: artifact for artifact in runtime.store.artifacts_of(lease.job.id)}
    assert artifacts["splat.ply.zip"].media_type == "application/zip"
    assert artifacts["preview.png"].media_type == "image/png"
    sheet, still = (Image.open(BytesIO(content(runtime, lease.job.id, name))) for name in ("preview.png", "still.webp"))
    foot = sheet.crop((0, sheet.height - still.height, still.width, sheet.height))
    assert np.abs(np.subtract(foot, still, dtype=float)).mean() < 8, "it is another picture"
    with zipfile.ZipFile(BytesIO(content(runtime, lease.job.id, "splat.ply.zip"))) as archive:
        first, last = (read_cloud(BytesIO(archive.read(f"frame_{n:04d}.ply")), file_type="ply") for n in (0, 5))
    moved = np.linalg.norm(last.means - first.means, axis=1)
    assert moved[400:].max() == 0
    high = first.means[:400, 2] > 0.8
    assert moved[:400][high].min() > 0.1  # end to end, the sway is 4 · 0.05 m per metre of height
    splat = animated_splat(content(runtime, lease.job.id, "tree.animated-splat.safetensors"))
    np.testing.assert_array_equal(splat.binding.moving, np.arange(600) < 400)


def test_the_mesh_that_came_with_a_cloud_is_taken(runtime: Runtime, tmp_path: Path) -> None:
    capture = Capture(cloud=post_cloud(), mesh=wedge())
    job = add_job(runtime, keep(runtime, capture, tmp_path / "cloud.safetensors"))
    run(runtime, hold(runtime, job))
    mesh = read_mesh_bundle(BytesIO(content(runtime, job.id, "mesh.safetensors")))
    np.testing.assert_array_equal(mesh.vertices, wedge().vertices)
