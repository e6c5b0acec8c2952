import json
import threading

import sqlalchemy as sa
from fastapi.testclient import TestClient
from pydantic import create_model

from jobs.lifecycle.attempts import cached_stage, fail, publish_stage, report_progress, start_stage, succeed
from jobs.records import AssetRecord, Claim, OutputFile
from jobs.store import new_id
from service.job_creation import KEY_EXPIRES_S, _fingerprint
from service.job_durations import JobDurations
from service.schemas.jobs import VoxelizeRequest
from service.services import Services
from tests.service.conftest import change_services, hold, publish, refusal


def create(client: TestClient, asset: AssetRecord, **body: object) -> dict[str, object]:
    response = client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset.id, **body})
    assert response.status_code == 202, response.text
    return response.json()  # type: ignore[no-any-return]


def claimed(client: TestClient, asset: AssetRecord, services: Services) -> tuple[str, Claim]:
    """A new job's address, and a worker's claim on it."""
    job_id = str(create(client, asset)["id"])
    return f"/v1/jobs/{job_id}", hold(services, job_id)


def test_a_job_is_accepted_and_reported(client: TestClient, asset: AssetRecord) -> None:
    response = client.post(
        "/v1/jobs", json={"type": "voxelize", "asset_id": asset.id, "seed": 7.0, "params": {"resolution": 64}}
    )
    assert response.status_code == 202
    job = response.json()
    assert response.headers["Location"] == f"/v1/jobs/{job['id']}"
    assert response.headers["Retry-After"] == "1"
    assert (job["state"], job["seed"], job["params"]["resolution"], job["attempt"]) == ("queued", 7, 64, 1)
    assert job["queue_position"] == 0
    assert [stage["name"] for stage in job["stages"]] == ["voxelize"]
    assert client.get(f"/v1/jobs/{job['id']}").json() == job


def test_a_key_survives_a_release_that_adds_a_field() -> None:
    later = create_model("Later", __base__=VoxelizeRequest, tempo=(float, 1.0))
    sent = {"type": "voxelize", "asset_id": "a", "seed": 3}
    now = _fingerprint(VoxelizeRequest.model_validate(sent))
    assert now == _fingerprint(later.model_validate(sent))  # type: ignore[arg-type]
    assert now != _fingerprint(VoxelizeRequest.model_validate(sent | {"seed": 4}))


def test_replicas_of_different_history_give_the_same_etag(client, asset, services) -> None:
    url = f"/v1/jobs/{create(client, asset)['id']}"
    estimates, tags = set(), set()
    for seconds in (5.0, 9.0):
        durations = JobDurations(services.store, {("seconds", "voxelize"): [seconds]})
        change_services(client, job_durations=durations)
        answer = client.get(url)
        estimates.add(answer.json()["eta_s"])
        tags.add(answer.headers["ETag"])
    assert (len(estimates), len(tags)) == (2, 1)


def test_a_page_of_jobs_takes_as_many_queries_as_one(client, asset, services) -> None:
    ids = [str(create(client, asset)["id"]) for _ in range(12)]
    for job_id in ids[:6]:
        publish(services, hold(services, job_id), "voxelize", f"{job_id}.bin", job_id.encode())
    single = [client.get(f"/v1/jobs/{job_id}").json() for job_id in reversed(ids)]
    statements: list[str] = []
    listen = (services.store.engine, "before_cursor_execute", lambda *args: statements.append(args[2]))
    sa.event.listen(*listen)
    page = client.get("/v1/jobs?limit=100").json()["data"]
    sa.event.remove(*listen)
    assert page == single
    assert sum(text != "BEGIN" for text in statements) <= 8, statements


def test_a_flood_of_errors_is_one_error(client: TestClient, asset: AssetRecord) -> None:
    for flood in (
        {f"k{number}": 1 for number in range(50_000)},
        {"params": {"formats": ["x"] * 50_000}},
        {"params": {"scribbles": [1] * 50_000}},
    ):
        problem = client.post("/v1/jobs", json={"type": "animate", "asset_id": asset.id} | flood).json()
        assert (problem["code"], len(problem["errors"])) == ("validation-failed", 1)
        assert "50,0" in problem["detail"]


def test_a_poll_tells_progress_and_then_that_nothing_changed(client, asset, services) -> None:
    url, lease = claimed(client, asset, services)
    start_stage(services.store, lease, "voxelize")
    report_progress(services.store, lease, "voxelize", 0.25)
    first = client.get(url)
    assert first.json()["progress"] == 0.25
    again = client.get(url, headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    report_progress(services.store, lease, "voxelize", 0.5)
    assert client.get(url, headers={"If-None-Match": first.headers["ETag"]}).json()["progress"] == 0.5


def test_facts_reach_the_manifest_and_the_cache(client: TestClient, asset: AssetRecord, services: Services) -> None:
    url, lease = claimed(client, asset, services)
    facts = [{"rms_error_m": 0.0086}, {}, {"warnings": ["26 of 60 photos have a camera"]}]
    files = tuple(
        OutputFile(name=name, media_type="a/b", sha256=name[0] * 64, bytes=1, facts=one)
        for name, one in zip(("a.glb", "b.glb", "report.json"), facts, strict=True)
    )
    start_stage(services.store, lease, "voxelize")
    publish_stage(services.store, lease, "voxelize", files, key="k" * 64, cached=False, retention_s=1000)
    assert [artifact["facts"] for artifact in client.get(f"{url}/artifacts").json()["artifacts"]] == [facts[0], {}, {}]
    assert client.get(url).json()["result"]["warnings"] == facts[2]["warnings"]
    assert cached_stage(services.store, "k" * 64) == files


def test_products_appear_stage_by_stage(client: TestClient, asset: AssetRecord, services: Services) -> None:
    url, lease = claimed(client, asset, services)
    publish(services, lease, "voxelize", "tree.voxels.safetensors", b"voxels")
    manifest = client.get(url + "/artifacts").json()
    assert not manifest["complete"]
    succeed(services.store, lease)
    job = client.get(url).json()
    assert (job["state"], job["progress"]) == ("succeeded", 1.0)
    assert "Retry-After" not in client.get(url).headers
    assert job["result"]["source"] == asset.summary
    assert job["expires_at"] is not None
    manifest = client.get(job["result"]["artifacts_url"]).json()
    assert manifest["complete"]
    assert [(a["name"], a["bytes"], a["id"]) for a in manifest["artifacts"]] == [
        ("tree.voxels.safetensors", 6, job["result"]["voxels_id"])
    ]


def test_cancel_is_accepted_twice_and_refused_after_the_end(client, asset, services) -> None:
    url = f"/v1/jobs/{create(client, asset)['id']}"
    assert client.post(url + "/cancel").json()["state"] == "canceled"
    assert client.post(url + "/cancel").status_code == 202
    url, lease = claimed(client, asset, services)
    assert client.post(url + "/cancel").json()["state"] == "canceling"
    succeed(services.store, lease)
    assert client.get(url).json()["state"] == "canceled"
    url, lease = claimed(client, asset, services)
    succeed(services.store, lease)
    assert client.post(url + "/cancel").json()["code"] == "conflict"


def test_the_list_is_paged_by_cursor_and_filtered(client: TestClient, asset: AssetRecord) -> None:
    ids = sorted((create(client, asset)["id"] for _ in range(5)), reverse=True)
    client.post(f"/v1/jobs/{ids[0]}/cancel")
    seen: list[str] = []
    url: str | None = "/v1/jobs?limit=2"
    while url:
        response = client.get(url)
        seen += [job["id"] for job in response.json()["data"]]
        url = response.links["next"]["url"] if "next" in response.links else None
        assert (response.json()["next_cursor"] is None) == (url is None)
    assert seen == ids
    assert [job["id"] for job in client.get("/v1/jobs?state=canceled").json()["data"]] == ids[:1]
    assert client.get("/v1/jobs?type=animate").json()["data"] == []
    refused = client.get("/v1/jobs?since=0.5")
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "query:since")


def test_a_wrong_field_is_named_and_texts_and_truth_values_are_no_numbers(client, asset) -> None:
    for body, pointer in (
        *(({"seed": seed}, "/seed") for seed in (True, "1", 0.5)),
        ({"cancel_after_s": "60"}, "/cancel_after_s"),
        *(({"params": {"resolution": value}}, "/params/resolution") for value in (100, "64")),
        ({"params": {"resolutoin": 64}}, "/params/resolutoin"),
        ({"type": "animate", "params": {"formats": []}}, "/params/formats"),
        ({"type": "animate", "params": {"formats": ["sog"]}}, "/params/formats/0"),
        ({"type": "animate", "params": {"fps": 1e9}}, "/params/fps"),
        ({"type": "reconstruct", "params": {"quality": "best"}}, "/params/quality"),
        ({"type": "animate", "params": {"loop": 1}}, "/params/loop"),
        *(({"type": "animate", "params": {"wind": {"speed_m_s": v}}}, "/params/wind/speed_m_s") for v in (-1, "5")),
        ({"type": "animate", "params": {"wind": {"gust": True}}}, "/params/wind/gust"),
        ({"type": "diffuse", "preset": "no-such-model"}, "/preset"),
    ):
        response = client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset.id} | body)
        assert (response.status_code, response.json()["code"]) == (422, "validation-failed"), body
        assert [error["pointer"] for error in response.json()["errors"]] == [pointer]


def test_a_job_needs_an_asset_of_its_kind(client: TestClient, asset: AssetRecord) -> None:
    refusal(client.post("/v1/jobs", json={"type": "reconstruct", "asset_id": asset.id}), 409, "conflict")
    for unknown in (new_id(), "nonsense"):
        assert client.post("/v1/jobs", json={"type": "voxelize", "asset_id": unknown}).status_code == 404
    client.delete(f"/v1/assets/{asset.id}")
    assert client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset.id}).status_code == 410


def test_a_full_queue_or_disk_refuses(client: TestClient, asset: AssetRecord, services: Services) -> None:
    create(client, asset)
    for name, value, code in (("max_queued_jobs", 1, "queue-full"), ("min_free_bytes", 1 << 60, "disk-full")):
        change_services(client, settings=services.settings.model_copy(update={name: value}))
        response = client.post("/v1/jobs", json={"type": "voxelize", "asset_id": asset.id})
        assert (response.status_code, response.json()["code"]) == (503, code)
        assert response.headers["Retry-After"]


def test_an_ended_job_can_be_deleted_with_its_files(client: TestClient, asset: AssetRecord, services: Services) -> None:
    url, lease = claimed(client, asset, services)
    publish(services, lease, "voxelize", "tree.voxels.safetensors", b"voxels")
    (artifact,) = client.get(url + "/artifacts").json()["artifacts"]
    assert client.delete(url).json()["code"] == "conflict"
    succeed(services.store, lease)
    assert client.delete(url).status_code == 204
    gone = [client.get(path).status_code for path in (url, url + "/artifacts", artifact["url"])]
    assert gone == [410, 410, 404]
    assert client.delete(url).status_code == 410
    assert client.get("/v1/jobs").json()["data"] == []


def test_an_idempotency_key_makes_one_job(client: TestClient, asset: AssetRecord, services: Services) -> None:
    body = {"type": "voxelize", "asset_id": asset.id}
    first, again = (client.post("/v1/jobs", json=body, headers={"Idempotency-Key": "k"}) for _ in range(2))
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json()["id"] == again.json()["id"]
    other = client.post("/v1/jobs", json=body | {"seed": 5}, headers={"Idempotency-Key": "k"})
    assert (other.status_code, other.json()["code"]) == (422, "idempotency-key-reused")
    now = services.store.clock()
    services.store.clock = lambda: now + KEY_EXPIRES_S + 1
    later = client.post("/v1/jobs", json=body | {"seed": 5}, headers={"Idempotency-Key": "k"})
    assert later.json()["id"] != first.json()["id"]


def test_a_failed_job_says_why_and_runs_again(client: TestClient, asset: AssetRecord, services: Services) -> None:
    old = create(client, asset, seed=3)
    url = f"/v1/jobs/{old['id']}/retry"
    assert client.post(url).status_code == 409
    fail(services.store, hold(services, str(old["id"])), code="out-of-memory", message="found, allowed")
    failed = client.get(f"/v1/jobs/{old['id']}").json()
    problem = failed["error"]
    assert (failed["state"], problem["code"], problem["detail"]) == ("failed", "out-of-memory", "found, allowed")
    new = client.post(url)
    assert new.status_code == 202
    assert (new.json()["retry_of"], new.json()["seed"]) == (old["id"], 3)
    assert (new.json()["state"], new.json()["error"], new.json()["attempt"]) == ("queued", None, 1)


def test_a_job_is_followed_by_its_events(client: TestClient, asset: AssetRecord, services: Services) -> None:
    job = create(client, asset)
    lease = hold(services, str(job["id"]))
    publish(services, lease, "voxelize", "tree.voxels.safetensors", b"voxels")
    url = f"/v1/jobs/{job['id']}/events"
    timer = threading.Timer(0.5, lambda: succeed(services.store, lease))
    timer.start()
    payload = client.get(url)
    timer.join()
    assert payload.headers["Content-Type"].startswith("text/event-stream")
    events = [dict(line.split(": ", 1) for line in event.splitlines()) for event in payload.text.strip().split("\n\n")]
    assert [json.loads(event["data"])["state"] for event in events] == ["running", "succeeded"]
    assert client.get(url, headers={"Last-Event-ID": events[0]["id"]}).text.count("event: job") == 1
    assert client.get(url, headers={"Last-Event-ID": events[1]["id"]}).text == ""
    assert client.get(f"/v1/jobs/{new_id()}/events").status_code == 404
    assert services.streams.open.total() == 0


def test_a_format_without_its_library_is_neither_offered_nor_accepted(client, asset, monkeypatch) -> None:
    assert "usd" in [product["format"] for product in client.get("/v1/limits").json()["products"]]
    monkeypatch.setattr("dynamictree.export.table.find_spec", lambda name: None)
    assert "usd" not in [product["format"] for product in client.get("/v1/limits").json()["products"]]
    body = {"type": "animate", "asset_id": asset.id, "params": {"formats": ["usd"]}}
    response = client.post("/v1/jobs", json=body)
    assert response.status_code == 422
    assert "pip install 'dynamictree[usd]'" in response.json()["detail"]


def test_limits_tell_what_each_quality_of_photos_means(client: TestClient) -> None:
    """640 px, 60,000 Gaussians, SH 1 and 80 views were the limits, and nothing said so."""
    draft, standard, high = client.get("/v1/limits").json()["photo_qualities"]
    assert [each["quality"] for each in (draft, standard, high)] == ["draft", "standard", "high"]
    for name in ("photo_px", "splat_px", "max_gaussians", "sh_degree", "max_views", "num_steps"):
        assert draft[name] <= standard[name] <= high[name]


def test_what_only_photos_have_is_refused_of_a_mesh(client: TestClient, asset: AssetRecord) -> None:
    body = {"type": "animate", "asset_id": asset.id}
    strokes = [{"photo": "a.jpg", "plant": True, "points": [[0.5, 0.5]]}]
    own = {"scribbles": strokes, "only_plant": True, "splat_steps": 500, "video_frames": 20, "height_m": 3.0}
    for name, value in (own | {"quality": "high"}).items():
        refused = client.post("/v1/jobs", json=body | {"params": {name: value}})
        [error] = refused.json()["errors"]
        assert (refused.status_code, error["pointer"], error["code"]) == (422, f"/params/{name}", "not-allowed")
        assert f"of kind mesh; {name} is allowed with photos or a film only" in error["detail"]
    unset = {"scribbles": None, "only_plant": False, "splat_steps": None, "video_frames": None, "quality": "standard"}
    assert client.post("/v1/jobs", json=body | {"params": unset}).status_code == 202
