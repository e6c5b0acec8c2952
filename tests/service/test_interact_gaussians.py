"""Output `gaussians` of /v1/interact: a cloud that was sent moves as its mesh does."""

# ruff: noqa: F811

import numpy as np
import pytest
from safetensors.numpy import load

from dynamictree.gaussian.binding import bind
from dynamictree.gaussian.deform import Deformer
from dynamictree.gaussian.from_mesh import splats_of_mesh
from dynamictree.plant.capture import Capture
from jobs.storage.assets import delete_asset, read_asset
from tests.service.conftest import refusal
from tests.service.pushed import client, grown, poke, post, served_id, spectrum  # noqa: F401


@pytest.fixture(scope="module")
def capture(grown) -> Capture:
    cloud = splats_of_mesh(grown.mesh, per_face=1, at_least=0, rng=np.random.default_rng(0)).cloud
    rows = np.random.default_rng(1).permutation(cloud.num_gaussians)[:2000]
    return Capture(cloud=cloud.subset(rows), mask=np.arange(2000) % 4 > 0)


@pytest.fixture(scope="module")
def cloud_spectrum(grown, capture, spectrum, client, tmp_path_factory) -> str:
    box_m = [[-50, -50, -50], [50, 50, float(capture.cloud.means[:, 2].max()) - 0.5]]
    return served_id(client, grown.mesh, spectrum, tmp_path_factory.mktemp("cloud"), sent=capture, box_m=box_m)


def test_gaussians_move_as_the_vertices_do(client, cloud_spectrum, capture, grown, poke) -> None:
    options = {"accept": "application/vnd.safetensors", "num_frames": 3, "dt_s": 0.2}
    low = capture.cloud.means[:, 2] <= capture.cloud.means[:, 2].max() - 0.5
    moving = np.flatnonzero(low & (np.arange(2000) % 4 > 0))
    highest = capture.cloud.means[moving[np.argmax(capture.cloud.means[moving, 2])]].tolist()
    poke = poke | {"impulse_n_s": [30.0, 10.0, 0.0], "at": {"point_m": highest, "radius_m": 0.5}}
    answer = post(client, cloud_spectrum, poke, output="gaussians", **options)
    assert answer.status_code == 200, answer.text
    frames = load(answer.content)
    vertices = load(post(client, cloud_spectrum, poke, output="vertices", **options).content)["displacement"]
    np.testing.assert_array_equal(frames["rows"], moving)
    binding = bind(capture.cloud, grown.mesh)
    for frame in range(3):
        pose = Deformer(binding).pose(vertices[frame])
        for name in ("means", "quaternions", "scales"):
            np.testing.assert_allclose(frames[name][frame], getattr(pose, name)[frames["rows"]], atol=1e-5)
    assert np.abs(frames["means"][2] - frames["means"][0]).max() > 1e-3
    np.testing.assert_array_equal(frames["q"].shape[:2], (1, 3))


def test_too_many_gaussians_are_refused_with_what_fits(client, cloud_spectrum, poke, monkeypatch) -> None:
    monkeypatch.setattr("service.routes.interact.MAX_DISPLACEMENT_BYTES", 100_000)
    refused = post(client, cloud_spectrum, poke, accept="*/*", output="gaussians", num_frames=60)
    assert (refused.status_code, "frames at a time" in refused.json()["detail"]) == (422, True)


def test_gaussians_are_gone_with_their_asset(client, cloud_spectrum, services, poke, monkeypatch) -> None:
    """The last test on this asset, which no memory holds."""
    monkeypatch.setattr(services.trees, "get", lambda _: None)
    asset_id = services.store.job(services.store.artifact(cloud_spectrum).job_id).asset_id
    prepared = read_asset(services.store, asset_id).prepared
    assert prepared is not None
    for go in (lambda: services.artifacts.delete(prepared.sha256), lambda: delete_asset(services.store, asset_id)):
        go()
        refusal(post(client, cloud_spectrum, poke, accept="*/*", output="gaussians", num_frames=2), 410, "expired")
