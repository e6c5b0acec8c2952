"""What a worker asks of the store waits for a database that is away; what a request asks does not."""

import sqlite3
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy as sa

from jobs.database import postgres_connection
from jobs.database.engine import open_engine
from jobs.lifecycle.attempts import claim, publish, publish_stage, start_stage, succeed
from jobs.records import OutputFile
from jobs.states import JobState
from jobs.storage.assets import add_asset
from jobs.store import Store
from tests.jobs.conftest import add_job, make_asset


@pytest.fixture
def locked(tmp_path: Path) -> Iterator[tuple[Store, sqlite3.Connection]]:
    """A store, and another process's way to hold it up."""
    path = tmp_path / "jobs.sqlite"
    store = Store.open(f"sqlite:///{path}")

    @sa.event.listens_for(store.engine, "connect")
    def _hurry(connection: sqlite3.Connection, _: object) -> None:
        connection.execute("PRAGMA busy_timeout=50")

    other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    yield store, other
    other.close()
    store.close()


def test_a_worker_waits_and_a_request_does_not(locked: tuple[Store, sqlite3.Connection]) -> None:
    store, other = locked
    job = add_job(store, add_asset(store, make_asset(store.clock()))[0])
    store.engine.dispose()  # so that the next connection hurries
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(sa.exc.OperationalError):
        claim(store, job.id, 1, owner="w", lease_s=60)
    store.patience_s = 30.0
    began = time.monotonic()
    threading.Timer(0.3, lambda: other.execute("ROLLBACK")).start()
    lease = claim(store, job.id, 1, owner="w", lease_s=60)
    assert lease is not None
    assert 0.3 <= time.monotonic() - began < 25


def test_what_was_committed_may_be_asked_again(store: Store) -> None:
    job = add_job(store, add_asset(store, make_asset(store.clock()))[0], "voxelize")
    lease = claim(store, job.id, 1, owner="w", lease_s=60)
    assert lease is not None
    again = claim(store, job.id, 1, owner="w", lease_s=60)  # the first answer was lost
    assert again is not None
    assert claim(store, job.id, 1, owner="another", lease_s=60) is None
    start_stage(store, lease, "voxelize")
    file = OutputFile(name="a", media_type="x/y", sha256="c" * 64, bytes=1)
    for digest in "bcc":  # the first is replaced
        offered = (file, replace(file, name="b", sha256=digest * 64), replace(file, name="draft"))
        publish(store, lease, "voxelize", offered, retention_s=100)
    early = {artifact.name: artifact.id for artifact in store.artifacts_of(job.id)}
    changed = replace(file, name="b", sha256="d" * 64)
    for _ in range(2):
        publish_stage(store, lease, "voxelize", (file, changed), key="k", cached=False, retention_s=100)
    final = {artifact.name: artifact for artifact in store.artifacts_of(job.id)}
    assert (sorted(final), final["b"].sha256) == (["a", "b"], changed.sha256)
    assert final["a"].id == early["a"], "a client may hold the id of a file that did not change"
    assert final["b"].id != early["b"]
    assert succeed(store, lease) == JobState.SUCCEEDED


def test_a_statement_without_an_answer_ends_and_the_next_one_has_its_own(postgres_url, monkeypatch) -> None:
    engine = open_engine(postgres_url)
    with engine.connect() as connection:
        monkeypatch.setattr(postgres_connection, "ANSWER_S", 0.3)
        with pytest.raises(sa.exc.OperationalError, match="did not answer within"):
            connection.execute(sa.text("SELECT pg_sleep(2)"))
        assert connection.invalidated
    with engine.connect() as connection:
        assert connection.execute(sa.text("SELECT 7")).scalar_one() == 7
    engine.dispose()
