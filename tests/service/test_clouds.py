"""Splats, scans and scenes of several trees as assets, and what a job on them may ask for."""

from dataclasses import replace
from functools import partial
from io import BytesIO

import numpy as np
import pytest
from fastapi.testclient import TestClient
from safetensors.numpy import load

from dynamictree.formats.mesh.obj_writer import write_obj
from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.formats.splat.splat import write_splat
from dynamictree.formats.tensors.bundle import read_cloud_bundle
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.mesh import join_meshes
from dynamictree.plant.capture import Capture, carrying_mesh
from dynamictree.source import Source
from jobs.records import AssetRecord
from jobs.storage.assets import read_asset
from service.routes import surface
from service.services import Services
from tests.clouds import cloud_at
from tests.formats.meshes import written
from tests.plant.stand import tree
from tests.service.conftest import refusal
from tests.service.test_assets import left_behind, photo, send, zipped


def post_cloud(count: int = 400, *, degree: int = 0) -> GaussianCloud:
    """A hollow post, one metre high, as a trained splat has it: −Y up."""
    rng = np.random.default_rng(3)
    angle = rng.random(count) * 2 * np.pi
    means = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), rng.random(count)], axis=1)
    cloud = cloud_at(means, scale=0.03, sh=rng.normal(size=(count, (degree + 1) ** 2, 3)))
    return replace(cloud, source=Source(up_axis="-Y"))


ply_of, splat_of = partial(written, write_gaussian_ply), partial(written, write_splat)
mask_of = partial(written, lambda values, stream: np.save(stream, values))


def stored_capture(services: Services, asset_id: str) -> Capture:
    prepared = read_asset(services.store, asset_id).prepared
    assert prepared is not None
    return read_cloud_bundle(BytesIO(b"".join(services.artifacts.read(prepared.sha256))))


def test_a_splat_becomes_an_asset(client: TestClient, services: Services) -> None:
    cloud = post_cloud(degree=1)
    response = send(client, ("tree.ply", ply_of(cloud)))
    assert response.status_code == 201, response.text
    asset = response.json()
    assert (asset["kind"], asset["summary"]["num_gaussians"], asset["summary"]["sh_degree"]) == ("cloud", 400, 1)
    assert asset["summary"]["source_up_axis"] == "-Y"
    np.testing.assert_allclose(stored_capture(services, asset["id"]).cloud.means, cloud.means, atol=1e-6)
    again = send(client, ("tree.ply", ply_of(cloud)))
    assert (again.status_code, again.json()["id"], again.json()["kind"]) == (200, asset["id"], "cloud")
    assert left_behind(services) == []


def test_mask_and_mesh_come_with_a_splat(client: TestClient, services: Services) -> None:
    cloud = post_cloud()
    mesh = carrying_mesh(Capture(cloud=cloud))
    turned = mesh.with_vertices(np.ascontiguousarray(mesh.vertices[:, [0, 2, 1]] * np.array([1, -1, 1], np.float32)))
    mask = np.arange(400) < 300
    files = (("mesh.obj", written(write_obj, turned)), ("tree.splat", splat_of(cloud)), ("mask.npy", mask_of(mask)))
    for sent in (files, (("all.zip", zipped(*files)),)):
        asset = send(client, *sent).json()
        assert (asset["kind"], asset["summary"]["num_movable"]) == ("cloud", 300)
        capture = stored_capture(services, asset["id"])
        assert capture.mesh is not None
        scale = capture.cloud.source.scale  # the splat's unit is not known: the mesh is scaled as it is
        assert scale > 1
        np.testing.assert_allclose(capture.mesh.vertices, mesh.vertices * scale, atol=1e-4 * scale)
        np.testing.assert_array_equal(capture.mask, mask)


def test_a_note_beside_a_mesh_is_no_scan(client: TestClient) -> None:
    obj = b"v 0.5 0 0\nv 0 0 2\nv 1 0 2\nf 1 2 3\n"
    assert send(client, ("tree.obj", obj), ("license.txt", b"1 2 3\n")).json()["kind"] == "mesh"
    points = b"".join(b"%d %d %d\n" % (n, n % 7, n % 5) for n in range(100))
    assert send(client, ("tree.xyz", points)).json()["kind"] == "cloud"


HEADER = b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n"
FLOATS = b"".join(b"property float %s\n" % name.encode() for name in ("x", "y", "z", "f_dc_0", "opacity"))


def with_values(**values: float) -> bytes:
    cloud = post_cloud()
    changed = {name: np.full_like(getattr(cloud, name), value) for name, value in values.items()}
    return ply_of(GaussianCloud(**{**cloud.__dict__, **changed}))


BAD_CLOUDS = {
    "properties missing": ("a.ply", HEADER % 1 + FLOATS + b"end_header\n" + bytes(20), 415, "f_dc_1, f_dc_2"),
    "fifty million": ("a.ply", ply_of(post_cloud()).replace(b"vertex 400", b"vertex 50000000"), 422, "at most 5,000"),
    "not finite": ("a.ply", with_values(means=np.nan), 422, "not finite"),
    "nothing visible": ("a.ply", with_values(opacity=0.0), 422, "nothing is visible"),
    "SOG": ("tree.sog", zipped(("meta.json", b"{}")), 415, "version 1"),
}


@pytest.mark.parametrize("what", BAD_CLOUDS)
def test_a_bad_cloud_is_refused_and_nothing_stays(client: TestClient, services: Services, what: str) -> None:
    name, content, status, message = BAD_CLOUDS[what]
    response = send(client, (name, content))
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    assert message in response.json()["detail"]
    assert left_behind(services) == []


def test_two_clouds_are_one_too_many(client: TestClient) -> None:
    cloud = splat_of(post_cloud())
    assert "2 clouds" in send(client, ("a.splat", cloud), ("b.splat", cloud)).json()["detail"]
    assert "3 meshes or clouds" in send(client, *((f"{n}.splat", cloud) for n in "abc")).json()["detail"]
    bad_mask = send(client, ("a.splat", cloud), ("mask.npy", mask_of(np.ones(3, np.bool_))))
    assert "3 values for 400" in bad_mask.json()["detail"]


@pytest.fixture
def cloud_id(client: TestClient) -> str:
    identity: str = send(client, ("tree.ply", ply_of(post_cloud(degree=1)))).json()["id"]
    return identity


def test_a_job_on_a_cloud_makes_its_mesh_first(client: TestClient, cloud_id: str) -> None:
    body = {"type": "animate", "asset_id": cloud_id, "params": {"box_m": [[-1, -1, 0], [1, 1, 2]]}}
    job = client.post("/v1/jobs", json=body).json()
    assert [stage["name"] for stage in job["stages"]] == ["reconstruct", "voxelize", "diffuse", "animate"]
    assert job["params"]["formats"] == ["splat", "png"]
    assert job["params"]["box_m"] == [[-1, -1, 0], [1, 1, 2]]
    assert client.post("/v1/jobs", json={"type": "reconstruct", "asset_id": cloud_id}).status_code == 202


def test_a_cloud_has_points_to_look_at_while_its_job_runs(client, cloud_id, monkeypatch) -> None:
    cloud = post_cloud(degree=1)
    tensors = load(client.get(f"/v1/assets/{cloud_id}/points").content)
    assert tensors["points"].shape == (400, 3)
    np.testing.assert_allclose(np.sort(tensors["points"][:, 2]), np.sort(cloud.means[:, 2]), atol=1e-5)
    expected = np.clip(0.5 + 0.28209479 * cloud.sh[:, 0], 0, 1)
    np.testing.assert_allclose(tensors["colours"] / 255, expected, atol=0.003)
    assert (tensors["radius_m"] > 0).all()
    monkeypatch.setattr(surface, "MAX_POINTS", 150)
    assert len(load(client.get(f"/v1/assets/{cloud_id}/points").content)["points"]) == 134  # every third


def test_a_mesh_has_no_points(client: TestClient, asset: AssetRecord) -> None:
    refusal(client.get(f"/v1/assets/{asset.id}/points"), 409, "conflict")


def test_what_does_not_fit_is_refused_when_asked(client, cloud_id, services, monkeypatch) -> None:
    meshes = (name + b"v 0.5 0 0\nv 0 0 2\nv 1 0 2\nf 1 2 3\n" for name in (b"", b"o Bush\n"))
    mesh_id, bush_id = (send(client, ("tree.obj", mesh)).json()["id"] for mesh in meshes)
    photos_id = send(client, *((f"p{i}.jpg", photo(i)) for i in range(8))).json()["id"]
    for params in ({"still_box_m": [[0, 0, 0], [1, 1, 1]]}, {"still": ["pot"]}):
        refused = client.post("/v1/jobs", json={"type": "voxelize", "asset_id": photos_id, "params": params})
        assert [error["pointer"] for error in refused.json()["errors"]] == [f"/params/{next(iter(params))}"]
    for id, words in ((mesh_id, "no part has a name"), (cloud_id, "take still_box_m"), (bush_id, "there are Bush")):
        body = {"type": "voxelize", "asset_id": id, "params": {"still": ["vase"]}}
        assert words in refusal(client.post("/v1/jobs", json=body), 422, "validation-failed")["errors"][0]["detail"]
    assert client.post("/v1/jobs", json=body | {"params": {"still": ["bush", "Bu*"]}}).status_code == 202
    params = {"wind_mode": "turbulent", "num_frames": 14_400}
    endless = {"type": "animate", "asset_id": mesh_id, "params": params}
    refused = client.post("/v1/jobs", json=endless | {"params": params | {"formats": ["glb"]}})
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid-input")
    assert "holds one period" in refused.json()["detail"]
    body = {"type": "animate", "asset_id": cloud_id, "params": {"formats": ["splat-ply"]}}
    monkeypatch.setattr("dynamictree.export.size.MAX_SEQUENCE_BYTES", 1000)
    assert "fewer frames" in refusal(client.post("/v1/jobs", json=body), 422, "invalid-input")["detail"]


def test_an_asset_lists_its_trees_and_a_job_takes_one(client: TestClient) -> None:
    one = tree(6.0, num_cards=60)
    two = join_meshes([one, one.with_vertices(one.vertices + np.float32([5, 0, 0]))])
    asset = send(client, ("two.ply", written(write_ply, two))).json()
    assert [entry["tree"] for entry in asset["summary"]["trees"]] == [1, 2]
    assert [entry["code"] for entry in asset["summary"]["warnings"]] == ["several-trees"]
    assert client.get(f"/v1/assets/{asset['id']}").json()["summary"]["trees"] == asset["summary"]["trees"]
    body = {"type": "voxelize", "asset_id": asset["id"], "params": {"tree": 2}}
    assert client.post("/v1/jobs", json=body).json()["params"]["tree"] == 2
    refused = client.post("/v1/jobs", json=body | {"params": {"tree": 3}})
    assert refused.status_code == 422
    assert [error["pointer"] for error in refused.json()["errors"]] == ["/params/tree"]
