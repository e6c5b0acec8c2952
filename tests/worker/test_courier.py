"""Webhooks, sent by the real courier to a real server, their signatures checked by Standard Webhooks' own library."""

import asyncio
import json
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from standardwebhooks import Webhook
from standardwebhooks.webhooks import WebhookVerificationError

from jobs.clients import webhooks
from jobs.errors import ConflictError
from jobs.lifecycle.attempts import fail, publish, succeed
from jobs.records import EVENTS
from jobs.settings import Settings
from jobs.storage.assets import add_asset
from jobs.store import Store
from tests.jobs.conftest import FILE, add_job, claim, make_asset
from tests.line import Handler, answering
from tests.servers import wait_for
from worker.courier import Courier


@dataclass
class Receiver:
    """What came, and what is answered."""

    url: str
    answers: list[int] = field(default_factory=list)
    wait_s: float = 0.0  # delay of its answer
    released: threading.Event = field(default_factory=threading.Event)  # what /tarpit waits for
    came: list[tuple[dict[str, str], bytes]] = field(default_factory=list)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    def receive(_: int, handler: Handler) -> None:
        hook.came.append((line.requests[-1].headers, handler.body))
        time.sleep(hook.wait_s)
        if handler.path == "/tarpit":
            hook.released.wait(60)
        handler.reply(hook.answers.pop(0) if hook.answers else 200, b"", Location="/elsewhere")

    with answering(receive) as line:
        hook = Receiver(f"{line.url}/hook")
        yield hook


@dataclass
class Scene:
    """A store with a clock of its own, a courier, a job to end."""

    store: Store
    courier: Courier
    now: list[float]

    def end_a_job(
        self, *, well: bool = True, artifact: bool = False, owner: str | None = None, **values: object
    ) -> str:
        store = self.store if owner is None else self.store.for_owner(owner)
        asset = add_asset(store, make_asset(store.clock()))[0]
        job = add_job(store, asset, **values)
        lease = claim(self.store, job.id)
        if artifact:
            publish(self.store, lease, "voxelize", (FILE,), retention_s=100)
        if well:
            succeed(self.store, lease)
        else:
            fail(self.store, lease, code="out-of-memory", message="found, allowed")
        return job.id

    def round(self) -> int:
        """Attempt every due delivery once, wait for all, and return their number."""

        async def attempted() -> int:
            started = await self.courier.start_due()
            await asyncio.gather(*self.courier.running)
            return started

        return asyncio.run(attempted())


@pytest.fixture
def scene(tmp_path: Path, receiver: Receiver) -> Iterator[Scene]:
    now = [time.time()]  # the library refuses what is five minutes off
    store = Store.open(f"sqlite:///{tmp_path / 'jobs.sqlite'}", clock=lambda: now[0])
    settings = Settings(
        state_dir=tmp_path, outbound_hosts=(receiver.url.split("/")[2],), webhook_retry_s=(0.0, 5.0, 60.0)
    )
    yield Scene(store, Courier(store, settings), now)
    store.close()


def test_the_end_of_a_job_is_delivered_and_signed(scene: Scene, receiver: Receiver) -> None:
    endpoint = webhooks.add_endpoint(scene.store, receiver.url, EVENTS)
    job_id = scene.end_a_job()
    assert scene.round() == 1
    headers, body = receiver.came[0]
    hook = Webhook(endpoint.secret).verify(body, headers)
    assert (hook["type"], hook["data"]["id"], hook["data"]["state"]) == ("job.succeeded", job_id, "succeeded")
    with pytest.raises(WebhookVerificationError):
        Webhook(endpoint.secret).verify(body.replace(b"succeeded", b"failed"), headers)
    assert scene.round() == 0
    log = webhooks.deliveries(scene.store, endpoint.id, before=None, limit=10)
    assert [(one.state, one.log[0].status) for one in log] == [("delivered", 200)]


def test_a_failed_delivery_is_repeated_on_schedule(scene: Scene, receiver: Receiver) -> None:
    endpoint = webhooks.add_endpoint(scene.store, receiver.url, ("job.failed",))
    scene.end_a_job()
    scene.end_a_job(well=False)
    receiver.answers = [500, 302, 503]
    tries = []
    for later in (0, 4, 1, 59, 1, 1000):
        scene.now[0] += later
        tries.append(scene.round())
    assert tries == [1, 0, 1, 0, 1, 0]
    (delivery,) = webhooks.deliveries(scene.store, endpoint.id, before=None, limit=10)
    assert (delivery.state, [attempt.status for attempt in delivery.log]) == ("failed", [500, 302, 503])
    assert "redirects" in delivery.log[1].detail
    assert len({headers["webhook-id"] for headers, _ in receiver.came}) == 1


def test_events_of_a_job_come_in_order(scene: Scene, receiver: Receiver) -> None:
    """The end is due meanwhile, and waits for the event before it."""
    webhooks.add_endpoint(scene.store, receiver.url, EVENTS)
    receiver.answers = [503]
    scene.end_a_job(artifact=True)
    rounds = []
    for later in (0, 0, 5, 0, 0):
        scene.now[0] += later
        rounds.append(scene.round())
    assert rounds == [1, 0, 1, 1, 0]
    events = [json.loads(body)["type"] for _, body in receiver.came]
    assert events == ["job.first-artifact", "job.first-artifact", "job.succeeded"]


def test_an_endpoint_without_events_gets_those_that_a_job_names(scene: Scene, receiver: Receiver) -> None:
    endpoint = webhooks.add_endpoint(scene.store, receiver.url, ())
    scene.end_a_job()  # names none
    scene.end_a_job(artifact=True, webhook_id=endpoint.id)
    scene.end_a_job(artifact=True, webhook_id=endpoint.id, webhook_events=["job.first-artifact"])
    scene.end_a_job(webhook_id=endpoint.id, webhook_events=[])
    while scene.round():
        pass
    events = sorted(json.loads(body)["type"] for _, body in receiver.came)
    assert events == ["job.first-artifact", "job.succeeded"]


def test_an_endpoint_that_answers_gone_gets_no_more(scene: Scene, receiver: Receiver) -> None:
    endpoint = webhooks.add_endpoint(scene.store, receiver.url, EVENTS)
    scene.end_a_job()
    receiver.answers = [410]
    assert scene.round() == 1
    assert webhooks.endpoint(scene.store, endpoint.id).disabled_reason
    scene.end_a_job()
    scene.now[0] += 1e6
    assert scene.round() == 0


def test_what_leads_inside_is_not_called(scene: Scene, receiver: Receiver) -> None:
    scene.courier.outbound = type(scene.courier.outbound)()  # as without the setting outbound_hosts
    endpoint = webhooks.add_endpoint(scene.store, receiver.url, EVENTS)
    scene.end_a_job()
    assert scene.round() == 1
    (delivery,) = webhooks.deliveries(scene.store, endpoint.id, before=None, limit=10)
    assert (delivery.log[0].status, receiver.came) == (None, [])


def test_a_bad_address_does_not_stop_other_deliveries(scene: Scene, receiver: Receiver) -> None:
    broken = webhooks.add_endpoint(scene.store, receiver.url + "/\x7f", EVENTS)
    webhooks.add_endpoint(scene.store, receiver.url, EVENTS)
    scene.end_a_job()
    assert scene.round() == 2
    assert len(receiver.came) == 1
    (delivery,) = webhooks.deliveries(scene.store, broken.id, before=None, limit=10)
    assert delivery.log[0].status is None


def test_one_who_is_slow_is_not_waited_for(scene: Scene, receiver: Receiver) -> None:
    scene.courier.settings = scene.courier.settings.model_copy(update={"webhook_timeout_s": 0.2})
    receiver.wait_s = 1.0
    endpoint = webhooks.add_endpoint(scene.store, receiver.url, EVENTS)
    scene.end_a_job()
    scene.round()
    (delivery,) = webhooks.deliveries(scene.store, endpoint.id, before=None, limit=10)
    assert "no answer within" in delivery.log[0].detail


def test_what_one_courier_tells_no_other_does(scene: Scene, receiver: Receiver) -> None:
    webhooks.add_endpoint(scene.store, receiver.url, EVENTS)
    scene.end_a_job()
    claimed = [webhooks.claim_due(scene.store, lease_s=30, limit=10, per_owner=4, busy={}) for _ in range(2)]
    assert [len(deliveries) for deliveries in claimed] == [1, 0]
    scene.now[0] += 31
    assert scene.round() == 1


def test_endpoints_have_a_limit(scene: Scene, receiver: Receiver) -> None:
    attempt = [webhooks.add_endpoint(scene.store, receiver.url, ()) for _ in range(webhooks.MAX_ENDPOINTS)]
    with pytest.raises(ConflictError):
        webhooks.add_endpoint(scene.store, receiver.url, ())
    webhooks.delete_endpoint(scene.store, attempt[0].id)
    assert len(webhooks.endpoints(scene.store)) == webhooks.MAX_ENDPOINTS - 1


def test_one_owner_s_tarpits_delay_nobody_else(scene: Scene, receiver: Receiver) -> None:
    """One owner's 60 deliveries hang; another owner's one is made after most of them."""
    tarpit = receiver.url.replace("/hook", "/tarpit")
    endpoint = webhooks.add_endpoint(scene.store.for_owner("slow"), tarpit, EVENTS)
    other = webhooks.add_endpoint(scene.store.for_owner("quick"), receiver.url, EVENTS)
    for owner, count in (("slow", 60), ("quick", 1)):
        for _ in range(count):
            scene.end_a_job(owner=owner)
    stopped = threading.Event()
    thread = threading.Thread(target=scene.courier.run, args=(stopped,))
    thread.start()
    try:
        wait_for(lambda: webhooks.deliveries(scene.store, other.id, before=None, limit=1)[0].state == "delivered")
        slow = webhooks.deliveries(scene.store, endpoint.id, before=None, limit=100)
        assert not any(d.state == "delivered" for d in slow)
    finally:
        stopped.set()
        receiver.released.set()
        thread.join()
