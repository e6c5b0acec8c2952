"""Compare-and-set, the fence, the lease: laws that make delivery at least once and publication exactly once."""

import itertools
from concurrent.futures import ThreadPoolExecutor

import pytest

from jobs.errors import FencedError
from jobs.lifecycle import attempts, maintenance
from jobs.lifecycle.rows import change_state, end_job
from jobs.records import AssetRecord, ClientKey
from jobs.states import TRANSITIONS, JobState
from jobs.storage.assets import delete_asset
from jobs.storage.uploads import add_upload, claim_uploads
from jobs.store import Store
from tests.jobs.conftest import FILE, Clock, add_job, claim, publish
from tests.rows import job_row, upload_row


def test_every_transition_that_is_not_drawn_is_refused(store: Store, asset: AssetRecord) -> None:
    for source, target in itertools.product(JobState, JobState):
        job = add_job(store, asset)
        with store.writing() as connection:
            path = {
                JobState.QUEUED: [],
                JobState.RUNNING: ["running"],
                JobState.CANCELING: ["canceling"],
                JobState.SUCCEEDED: ["running", "succeeded"],
                JobState.FAILED: ["running", "failed"],
                JobState.CANCELED: ["canceling", "canceled"],
            }[source]
            assert all(change_state(connection, job.id, JobState(step)) for step in path)
            assert change_state(connection, job.id, target) == (target in TRANSITIONS[source])


def test_one_of_many_claims_wins(store: Store, asset: AssetRecord) -> None:
    job = add_job(store, asset)
    owners = (f"worker-{number}" for number in range(8))
    with ThreadPoolExecutor(8) as pool:
        won = list(pool.map(lambda owner: attempts.claim(store, job.id, 1, owner=owner, lease_s=60), owners))
    assert (len(won), sum(claimed is not None for claimed in won)) == (8, 1)


def test_a_stale_attempt_publishes_nothing(store: Store, asset: AssetRecord, clock: Clock) -> None:
    job = add_job(store, asset)
    old = claim(store, job.id)
    attempts.start_stage(store, old, "voxelize")
    clock.now += 61
    assert maintenance.end_expired(store, max_lost_attempts=2) == [(job.id, JobState.RUNNING)]
    new = claim(store, job.id, attempt=2, owner="worker-2")
    for act in (
        lambda: publish(store, old),
        lambda: attempts.succeed(store, old),
        lambda: attempts.fail(store, old, code="x", message="y"),
        lambda: attempts.renew(store, job.id, 1, owner="worker-1", lease_s=60),
        lambda: attempts.cancel_requested(store, old),
        lambda: attempts.report_progress(store, old, "voxelize", 0.5),
        lambda: attempts.start_stage(store, old, "voxelize"),
        lambda: attempts.publish(store, old, "voxelize", (FILE,), retention_s=100),
        lambda: attempts.finish_cancel(store, old),
        lambda: attempts.release_attempt(store, old),
    ):
        with pytest.raises(FencedError, match="attempt 1"):
            act()
    assert attempts.claim(store, job.id, 1, owner="worker-2", lease_s=60) is None
    assert store.artifacts_of(job.id) == []
    publish(store, new)
    assert [a.sha256 for a in store.artifacts_of(job.id)] == [FILE.sha256]


@pytest.mark.parametrize(
    ("stages", "code"),
    [
        (["voxelize"] * 3, "poison-input"),
        ([None, "voxelize", None], "worker-lost"),
        ([None, None, None], "worker-lost"),
    ],
)
def test_attempts_are_capped(store, asset, clock, stages, code) -> None:
    job = add_job(store, asset)
    for attempt, stage in enumerate(stages, start=1):
        lease = claim(store, job.id, attempt=attempt)
        if stage == "voxelize":
            attempts.start_stage(store, lease, "voxelize")
        clock.now += 61
        maintenance.end_expired(store, max_lost_attempts=2)
    ended = store.job(job.id)
    assert (ended.state, ended.error_code) == (JobState.FAILED, code)
    assert "3 workers were lost" in (ended.error_message or "")


def test_work_handed_back_counts_no_loss(store: Store, asset: AssetRecord) -> None:
    job = add_job(store, asset)
    for attempt in range(1, 6):
        attempts.release_attempt(store, claim(store, job.id, attempt=attempt))
    assert store.job(job.id).attempt == 6
    assert [m.attempt for m in maintenance.messages_to_send(store, window=10)] == [6]


@pytest.mark.parametrize("way", ["queued", "succeed", "fail", "hand-back", "lost"])
def test_a_cancel_wins_over_the_end(store: Store, asset: AssetRecord, clock: Clock, way: str) -> None:
    job = add_job(store, asset)
    lease = None if way == "queued" else claim(store, job.id)
    store.cancel(job.id)
    if lease is None:
        assert attempts.claim(store, job.id, 1, owner="w", lease_s=60) is None
    elif way == "succeed":
        assert attempts.succeed(store, lease) == JobState.CANCELED
    elif way == "fail":
        assert attempts.fail(store, lease, code="x", message="y") == JobState.CANCELED
    elif way == "hand-back":
        attempts.release_attempt(store, lease)
    else:
        clock.now += 61
        maintenance.end_expired(store, max_lost_attempts=2)
    ended = store.job(job.id)
    assert (ended.state, {stage.state for stage in ended.stages}) == (JobState.CANCELED, {"canceled"})
    assert maintenance.messages_to_send(store, window=10) == []


def test_one_process_holds_a_lease(store: Store, clock: Clock) -> None:
    assert maintenance.hold_lease(store, "housekeeper", owner="a", lease_s=10)
    assert maintenance.hold_lease(store, "housekeeper", owner="a", lease_s=10)
    assert not maintenance.hold_lease(store, "housekeeper", owner="b", lease_s=10)
    assert maintenance.lease_names(store, "house") == ["housekeeper"]
    clock.now += 11
    assert maintenance.hold_lease(store, "housekeeper", owner="b", lease_s=10)
    maintenance.release_lease(store, "housekeeper", owner="a")
    assert maintenance.lease_names(store, "house") == ["housekeeper"]
    maintenance.release_lease(store, "housekeeper", owner="b")
    assert maintenance.lease_names(store, "house") == []


def place_of(store: Store, job_id: str) -> int | None:
    return store.positions_and_artifacts([store.job(job_id)])[job_id][0]


def test_a_final_state_is_written_once(store: Store, asset: AssetRecord) -> None:
    lease = claim(store, add_job(store, asset).id)
    attempts.succeed(store, lease)
    with store.writing() as connection:
        assert not end_job(connection, lease.job.id, JobState.FAILED, now=1.0)


def test_owners_take_turns(store: Store, asset: AssetRecord, clock: Clock) -> None:
    many, one = store.for_owner("many"), store.for_owner("one")
    first = []
    for _ in range(6):
        first.append(add_job(many, asset).id)
        clock.now += 1  # two jobs of one moment have no order
    last = add_job(one, asset).id

    def send() -> list[str]:
        messages = maintenance.messages_to_send(store, window=2)
        for message in messages:
            maintenance.mark_sent(store, message)
        return [message.job_id for message in messages]

    assert send() == [first[0], last]  # the second of the queue's two places goes to the other owner
    assert send() == []
    claim(store, last)
    assert send() == [first[1]]
    another = add_job(one, asset).id
    claim(store, first[0])
    claim(store, first[1])
    assert send() == [another, first[2]]  # fewer of this owner's jobs run


def test_the_place_in_the_queue_counts_turns(store: Store, asset: AssetRecord) -> None:
    many, one = store.for_owner("many"), store.for_owner("one")
    first = [add_job(many, asset) for _ in range(4)]
    last = add_job(one, asset)
    assert [place_of(store, job.id) for job in (*first, last)] == [0, 2, 3, 4, 1]


def test_a_pause_is_no_crash(store: Store, asset: AssetRecord, clock: Clock) -> None:
    job = add_job(store, asset)
    for attempt in range(1, 6):
        lease = claim(store, job.id, attempt=attempt)
        attempts.start_stage(store, lease, "voxelize")
        clock.now += 61
        assert maintenance.end_expired(store, max_lost_attempts=2) == [(job.id, JobState.RUNNING)]
        attempts.forgive_loss(store, job.id)  # the worker went on, and found its attempt taken
    assert store.job(job.id).attempt == 6


def test_a_client_key_gives_its_job_when_the_asset_is_gone(store: Store, asset: AssetRecord) -> None:
    key = ClientKey(key="post:a", body_sha256="a" * 64, expires_s=100)
    job = store.add_job(job_row(asset, now=store.clock()), stages=("voxelize",), client_key=key)[0]
    attempts.succeed(store, claim(store, job.id))
    delete_asset(store, asset.id)
    earlier = store.job_of_key(key)
    assert earlier is not None
    assert earlier.id == job.id
    assert store.for_owner("other").job_of_key(key) is None


def test_uploads_of_owners_take_turns(store: Store, clock: Clock) -> None:
    def begin(owner: str, number: int) -> None:
        values = {"state": "fetching", "length": None, "make_asset": True, "source_url": "https://a.example"}
        add_upload(store.for_owner(owner), upload_row(f"{owner}{number}", now=clock.now, **values))

    for number in range(9):
        begin("a", number)
    begin("b", 0)
    assert [u.id for u in claim_uploads(store, lease_s=60, limit=8, per_owner=2)] == ["a0", "b0", "a1"]
    assert claim_uploads(store, lease_s=60, limit=8, per_owner=2) == []
    begin("b", 1)
    assert [u.id for u in claim_uploads(store, lease_s=60, limit=8, per_owner=2)] == ["b1"]


def test_a_job_whose_queue_has_no_worker_goes_where_there_is_one(store, asset, clock) -> None:
    job = add_job(store, asset)
    maintenance.mark_sent(store, maintenance.messages_to_send(store, window=9)[0])
    assert maintenance.hold_lease(store, maintenance.worker_lease("gpu", "w"), owner="w", lease_s=1000)
    assert maintenance.reroute(store) == 0  # its own worker may only be starting again
    clock.now += maintenance.REROUTE_S + 1
    assert maintenance.reroute(store) == 1
    assert store.job(job.id).queue == "gpu"
    assert [message.queue for message in maintenance.messages_to_send(store, window=9)] == ["gpu"]
    assert maintenance.hold_lease(store, maintenance.worker_lease("cpu", "v"), owner="v", lease_s=1000)
    assert maintenance.reroute(store) == 0  # both are there
    maintenance.release_lease(store, maintenance.worker_lease("gpu", "w"), owner="w")
    assert maintenance.reroute(store) == 1
    assert claim(store, job.id).job.queue == "cpu"
    assert maintenance.reroute(store) == 0
