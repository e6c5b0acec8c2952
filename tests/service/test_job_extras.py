"""Waiting for a job, priorities, time left, webhook endpoints: what goes round a job."""

import threading
import time

import anyio
import pytest
from fastapi.testclient import TestClient

from jobs.clients.outbound import Outbound
from jobs.lifecycle.attempts import report_progress, start_stage, succeed
from jobs.lifecycle.maintenance import hold_lease, overdue_jobs, worker_lease
from jobs.records import AssetPart, AssetRecord
from jobs.settings import Settings
from jobs.states import stages_of
from jobs.storage.assets import add_asset
from service.app import create_app
from service.job_durations import JobDurations
from service.services import Services
from tests.line import answering
from tests.rows import asset_row, job_row
from tests.service.conftest import change_services, hold, refusal
from tests.service.test_assets import PLAIN, left_behind
from tests.service.test_jobs import claimed, create


def test_a_poll_may_wait_for_the_end(client: TestClient, asset: AssetRecord, services: Services) -> None:
    url, lease = claimed(client, asset, services)
    began = time.monotonic()
    still = client.get(url, headers={"Prefer": "wait=1"})
    assert (still.json()["state"], still.headers["Preference-Applied"]) == ("running", "wait=1")
    assert time.monotonic() - began >= 1
    timer = threading.Timer(0.3, lambda: succeed(services.store, lease))
    timer.start()
    assert client.get(url, headers={"Prefer": "respond-async, wait=30"}).json()["state"] == "succeeded"
    timer.join()


def test_a_poll_with_an_etag_may_wait_for_the_next_change(client, asset, services) -> None:
    url, lease = claimed(client, asset, services)
    start_stage(services.store, lease, "voxelize")
    seen = client.get(url).headers["ETag"]
    timer = threading.Timer(0.3, lambda: report_progress(services.store, lease, "voxelize", 0.5))
    timer.start()
    changed = client.get(url, headers={"Prefer": "wait=30", "If-None-Match": seen})
    timer.join()
    assert (changed.status_code, changed.json()["progress"]) == (200, 0.5)
    same = client.get(url, headers={"Prefer": "wait=0", "If-None-Match": changed.headers["ETag"]})
    assert same.status_code == 304


def test_the_time_left_comes_from_what_jobs_took_here(client, asset, services) -> None:
    job = create(client, asset)
    assert job["eta_s"] is None
    clock, now = services.store.clock, services.store.clock()
    lease = hold(services, str(job["id"]))
    start_stage(services.store, lease, "voxelize")
    services.store.clock = lambda: now + 40
    with services.store.writing() as connection:
        connection.exec_driver_sql("UPDATE stages SET state = 'succeeded', started_at = 0, finished_at = 40")
    succeed(services.store, lease)
    with services.store.writing() as connection:
        connection.exec_driver_sql("UPDATE jobs SET started_at = 0, finished_at = 50")
    services.store.clock = clock
    assert hold_lease(services.store, "worker:one", owner="one", lease_s=60)
    change_services(client, job_durations=JobDurations(services.store))  # as after ten seconds
    waiting = [create(client, asset) for _ in range(3)]
    assert [response["eta_s"] for response in waiting] == [40.0, 90.0, 140.0]
    running = hold(services, str(waiting[0]["id"]))
    start_stage(services.store, running, "voxelize")
    url, began = f"/v1/jobs/{waiting[0]['id']}", services.store.clock()
    report_progress(services.store, running, "voxelize", 0.01)
    for others_s, took_s, left_s in (([40], 0, 40), ([40], 30, 10), ([40], 100, None), ([40, 130, 150], 100, 40)):
        services.store.clock = lambda took_s=took_s: began + took_s
        change_services(client, job_durations=JobDurations(services.store, {("seconds", "voxelize"): others_s}))
        assert client.get(url).json()["eta_s"] == pytest.approx(left_s)  # as others that took longer than it has
    services.store.clock = lambda: began + 60
    report_progress(services.store, running, "voxelize", 0.75)
    assert client.get(url).json()["eta_s"] == pytest.approx(20, abs=0.5)  # estimated from its own pace


def test_photos_tell_from_the_first_minute_when_they_end(client, asset, services) -> None:
    """At 14 % by the mean of its stages a job was at 57 % of its time, and without a history its end was unknown."""
    job = job_row(asset, "animate", now=services.store.clock())
    job, _ = services.store.add_job(job, stages=stages_of("animate", "photos"))
    lease, began = hold(services, job.id), services.store.clock()
    start_stage(services.store, lease, "reconstruct")
    services.store.clock = lambda: began + 40
    report_progress(services.store, lease, "reconstruct", 0.1, worked_s=40.0)
    early = client.get(f"/v1/jobs/{job.id}").json()
    assert 350 < early["eta_s"] < 400
    assert early["progress"] == pytest.approx(40 / (40 + early["eta_s"]), abs=0.01)
    services.store.clock = lambda: began + 10_000
    start_stage(services.store, lease, "reconstruct")  # again, by another attempt
    report_progress(services.store, lease, "reconstruct", 0.6, worked_s=300.0)
    resumed = client.get(f"/v1/jobs/{job.id}").json()
    assert 200 < resumed["eta_s"] < 240
    assert resumed["progress"] > 0.5


def test_an_endpoint_shows_its_secret_once(client: TestClient, services: Services, asset: AssetRecord) -> None:
    change_services(client, outbound=Outbound(private_hosts=("127.0.0.1:9",)))
    inside = ("https://127.0.0.1/", "http://forest.example/", "https://169.254.169.254/latest/", "file:///etc/passwd")
    for url in (*inside, "nonsense"):
        problem = refusal(client.post("/v1/webhook-endpoints", json={"url": url}), 422, "fetch-failed")
        assert problem["suggestion"].startswith("Use a public https address")
    response = client.post("/v1/webhook-endpoints", json={"url": "http://127.0.0.1:9/hook", "events": ["job.failed"]})
    assert response.status_code == 201
    assert response.json()["secret"].startswith("whsec_")
    url = response.headers["Location"]
    assert "secret" not in client.get("/v1/webhook-endpoints").json()["data"][0]
    named = create(client, asset, webhook=response.json()["id"])
    client.post(f"/v1/jobs/{named['id']}/cancel")
    deliveries = client.get(url + "/deliveries").json()["data"]
    assert [(one["event"], one["state"], one["job_id"]) for one in deliveries] == [
        ("job.canceled", "pending", named["id"])
    ]
    other = create(client, asset, webhook=response.json()["id"])
    client.post(f"/v1/jobs/{other['id']}/cancel")
    page = client.get(url + "/deliveries?limit=1").json()
    [before] = client.get(f"{url}/deliveries?cursor={page['next_cursor']}").json()["data"]
    assert (page["data"][0]["job_id"], before["job_id"]) == (other["id"], named["id"])
    assert client.delete(url).status_code == 204
    assert client.delete(url).status_code == 404
    unknown = {"type": "voxelize", "asset_id": asset.id, "webhook": response.json()["id"]}
    assert client.post("/v1/jobs", json=unknown).status_code == 404


FILES = {"/tree.obj": PLAIN, "/no.obj": b"hello", "/large.obj": bytes(5000)}


@pytest.mark.parametrize(
    ("path", "promised", "code"),
    [
        ("/tree.obj", None, None),
        ("/tree.obj", "0" * 64, "checksum-mismatch"),
        ("/no.obj", None, "unsupported-format"),
        ("/absent.obj", None, "fetch-failed"),
        ("/large.obj", None, "payload-too-large"),
    ],
)
def test_an_address_becomes_an_asset(settings: Settings, path: str, promised: str | None, code: str | None) -> None:
    status, body = 200 if path in FILES else 404, FILES.get(path, b"")
    with answering(lambda _, handler: handler.reply(status, body)) as line:
        hosts = (line.url.removeprefix("http://"),)
        app = create_app(settings.model_copy(update={"outbound_hosts": hosts, "max_upload_bytes": 4000}))
        with TestClient(app, "http://localhost") as client:
            sent = client.post("/v1/assets", json={"url": f"{line.url}{path}", "sha256": promised, "unit_m": 2})
            assert (sent.status_code, sent.json()["state"]) == (202, "fetching")
            upload = client.get(sent.headers["Location"], headers={"Prefer": "wait=30"}).json()
            if code is None:
                asset = client.get(f"/v1/assets/{upload['asset_id']}").json()
                assert (asset["summary"]["extent_m"], asset["parts"][0]["name"]) == ([2.0, 2.0, 4.0], "tree.obj")
            else:
                assert (upload["state"], upload["error"]["code"]) == ("failed", code)
            assert left_behind(app.state.services) == []


def test_an_address_inside_is_not_fetched(client: TestClient) -> None:
    for url in ("https://169.254.169.254/latest/meta-data/", "http://127.0.0.1:6379/", "file:///etc/passwd"):
        refusal(client.post("/v1/assets", json={"url": url}), 422, "fetch-failed")


def test_a_stream_whose_head_is_not_taken_gives_its_place_back(client, asset, services) -> None:
    async def gone(_: object) -> None:
        raise RuntimeError("the connection is gone")

    async def connected() -> dict[str, str]:  # a mock that answers at once would be asked without end
        await anyio.sleep_forever()
        return {"type": "http.disconnect"}

    path = f"/v1/jobs/{create(client, asset)['id']}/events"
    scope = {"type": "http", "method": "GET", "path": path, "query_string": b"", "headers": [(b"host", b"localhost")]}
    with pytest.raises(BaseException, match=r"unhandled errors|gone"):
        client.portal.call(client.app, scope, connected, gone)
    assert services.streams.open.total() == 0


def test_a_job_goes_to_the_workers_that_it_needs(client: TestClient, asset: AssetRecord, services: Services) -> None:
    part = AssetPart(name="a.jpg", sha256="c" * 64, bytes=9)
    row = asset_row(part, now=services.store.clock(), kind="photos", prepared=None)
    photos = add_asset(services.store, row)[0]

    def queues() -> list[str]:
        jobs = [create(client, photos, type="reconstruct"), create(client, asset)]
        return [services.store.job(str(job["id"])).queue for job in jobs]

    assert queues() == ["cpu", "cpu"]  # nobody is there yet
    assert hold_lease(services.store, worker_lease("gpu", "two"), owner="two", lease_s=60)
    assert queues() == ["gpu", "gpu"]
    assert hold_lease(services.store, worker_lease("cpu", "one"), owner="one", lease_s=60)
    assert queues() == ["gpu", "cpu"]


def test_a_client_names_its_jobs_and_finds_them_again(client: TestClient, asset: AssetRecord) -> None:
    labels = {"external_id": "tree-7", "metadata": {"batch": "spring", "row": "3"}}
    job = create(client, asset, **labels)
    create(client, asset, type="diffuse")
    assert {name: job[name] for name in labels} == labels
    for query in ("external_id=tree-7", f"asset_id={asset.id}&type=voxelize", "state=queued&external_id=tree-7"):
        assert [one["id"] for one in client.get(f"/v1/jobs?{query}").json()["data"]] == [job["id"]], query
    assert client.get("/v1/jobs", params={"since": "2100-01-01T00:00:00Z"}).json()["data"] == []
    assert len(client.get("/v1/jobs", params={"since": job["created_at"]}).json()["data"]) == 2
    many = {f"k{number}": "v" for number in range(17)}
    body = {"type": "voxelize", "asset_id": asset.id, "metadata": many}
    assert client.post("/v1/jobs", json=body).status_code == 422


def test_a_job_is_canceled_after_its_time_running_or_not(client, asset, services) -> None:
    late, in_time = (str(create(client, asset, cancel_after_s=seconds)["id"]) for seconds in (10, 1000))
    hold(services, late)
    now = services.store.clock()
    services.store.clock = lambda: now + 11
    assert overdue_jobs(services.store) == [late]
    services.store.cancel(late)
    assert overdue_jobs(services.store) == []
    assert client.get(f"/v1/jobs/{late}").json()["state"] == "canceling"
    assert client.get(f"/v1/jobs/{in_time}").json()["state"] == "queued"
