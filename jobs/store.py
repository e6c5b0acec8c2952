"""The truth about assets, jobs, stages and artefacts. SQLAlchemy on SQLite or PostgreSQL.

What a worker does to a running job is in `attempts.py`, what the housekeeper does in `upkeep.py`.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from hashlib import sha256

import sqlalchemy as sa
from ulid import ULID

from jobs import tables as t
from jobs.database import insert_new, open_engine
from jobs.errors import ConflictError, GoneError, NotFoundError, QuotaError, ReusedKeyError
from jobs.joblog import Level, LogLine, lines, note
from jobs.migrations import migrate
from jobs.patience import patient
from jobs.records import ArtifactRecord, AssetPart, AssetRecord, ClientKey, JobRecord, StageRecord
from jobs.states import ACTIVE, JobState, JobType, states_before
from jobs.tallies import count
from jobs.webhooks import announce

HIDDEN = frozenset({"lease_owner", "lease_until", "lost_stages", "client_key", "body_sha256"})
"""Columns of a job that its record does not show."""


_ID: sa.BindParameter[str] = sa.bindparam("id")
_JOB = sa.select(t.jobs).where(t.jobs.c.id == _ID)
_STAGES = sa.select(t.stages).where(t.stages.c.job_id == _ID).order_by(t.stages.c.position)
_ARTIFACTS = sa.select(t.artifacts).where(t.artifacts.c.job_id == _ID).order_by(t.artifacts.c.id)
_NUM_AHEAD = sa.select(sa.func.count()).where(
    (t.jobs.c.state == JobState.QUEUED) & (t.jobs.c.queue == sa.bindparam("queue")) & (t.jobs.c.id < _ID)
)
"""What every poll asks, put together once: that takes as long as to ask it."""


def new_id() -> str:
    """A ULID: sorts by the time it was made."""
    return str(ULID())


class Store:
    """One process's way to the job store; with an owner, it knows only what is theirs."""

    def __init__(self, engine: sa.Engine, *, clock: Callable[[], float] = time.time, owner: str | None = None) -> None:
        self.engine = engine
        self.clock = clock
        self.owner = owner
        self.patience_s = 0.0  # how long what is marked @patient waits for a database that is away

    def for_owner(self, owner: str) -> "Store":
        """The same store, as one owner may see it: what is someone else's is not there."""
        return Store(self.engine, clock=self.clock, owner=owner)

    def mine(self, table: sa.Table) -> sa.ColumnElement[bool]:
        """The rows that this store knows."""
        return sa.true() if self.owner is None else table.c.owner == self.owner

    @classmethod
    def open(cls, url: str, *, clock: Callable[[], float] = time.time) -> "Store":
        """Connect, and bring the tables up to date."""
        engine = open_engine(url)
        migrate(engine)
        return cls(engine, clock=clock)

    def close(self) -> None:
        """Drop the pooled connections."""
        self.engine.dispose()

    @contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """A transaction that only reads; on SQLite it blocks no writer."""
        with self.engine.connect().execution_options(reading=True) as connection, connection.begin():
            yield connection

    @contextmanager
    def writing(self) -> Iterator[sa.Connection]:
        """A transaction that may write."""
        with self.engine.begin() as connection:
            yield connection

    # -- assets

    def add_asset(self, asset: AssetRecord) -> tuple[AssetRecord, bool]:
        """Keep an asset, or give the one that is there with the same fingerprint; tell whether it is new."""
        with self.writing() as connection:
            asset = replace(asset, owner=self.owner or "")
            live = self._live(asset.fingerprint)
            values = asdict(asset) | {"live_fingerprint": live, "bytes": asset.bytes}
            if insert_new(connection, t.assets, values, unique="live_fingerprint"):
                return asset, True
            same = t.assets.c.live_fingerprint == live
            connection.execute(t.assets.update().where(same).values(expires_at=asset.expires_at))
            return _asset(connection.execute(sa.select(t.assets).where(same)).one()), False

    def find_asset(self, fingerprint: str) -> AssetRecord | None:
        """The living asset of this fingerprint."""
        with self.reading() as connection:
            row = connection.execute(
                sa.select(t.assets).where(t.assets.c.live_fingerprint == self._live(fingerprint))
            ).one_or_none()
        return None if row is None else _asset(row)

    def _live(self, fingerprint: str) -> str:
        """What is unique among living assets: each owner has assets of their own, their bytes are shared."""
        return sha256(f"{self.owner} {fingerprint}".encode()).hexdigest() if self.owner else fingerprint

    @patient
    def asset(self, asset_id: str) -> AssetRecord:
        """One asset.

        Raises:
            NotFoundError, GoneError: there is none, or it was deleted or has expired.
        """
        with self.reading() as connection:
            this = (t.assets.c.id == asset_id) & self.mine(t.assets)
            row = connection.execute(sa.select(t.assets).where(this)).one_or_none()
        if row is None:
            raise NotFoundError(f"there is no asset {asset_id}")
        asset = _asset(row)
        if asset.deleted_at is not None:
            raise GoneError(f"asset {asset_id} was deleted or has expired; upload it again")
        return asset

    def delete_asset(self, asset_id: str) -> None:
        """Forget an asset; its bytes go with the next retention run.

        Raises:
            ConflictError: a job that has not ended needs it.
        """
        self.asset(asset_id)
        with self.writing() as connection:
            active = t.jobs.c.state.in_(ACTIVE) & (t.jobs.c.asset_id == asset_id)
            job_id = connection.execute(sa.select(t.jobs.c.id).where(active).limit(1)).scalar_one_or_none()
            if job_id is not None:
                raise ConflictError(f"asset {asset_id} is in use by job {job_id}; cancel it or wait for its end")
            gone = {"live_fingerprint": None, "deleted_at": self.clock()}
            connection.execute(t.assets.update().where(t.assets.c.id == asset_id).values(**gone))

    def kept_bytes(self) -> int:
        """What the owner's assets, uploads and products take [bytes]."""
        now = self.clock()
        live = t.assets.c.deleted_at.is_(None) & self.mine(t.assets)
        sums = (
            sa.select(sa.func.sum(t.assets.c.bytes)).where(live),
            sa.select(sa.func.sum(t.uploads.c.length)).where(t.uploads.c.asset_id.is_(None) & self.mine(t.uploads)),
            sa.select(sa.func.sum(t.artifacts.c.bytes))
            .join(t.jobs, t.jobs.c.id == t.artifacts.c.job_id)
            .where((t.artifacts.c.expires_at > now) & self.mine(t.jobs)),
        )
        with self.reading() as connection:
            return sum(int(connection.execute(query).scalar_one() or 0) for query in sums)

    # -- jobs

    def add_job(
        self,
        job: JobRecord,
        *,
        stages: tuple[JobType, ...],
        client_key: ClientKey | None = None,
        max_active: int | None = None,
    ) -> tuple[JobRecord, bool]:
        """Keep a new job, its stages and the message for a worker, in one transaction; tell whether it is new.

        Raises:
            GoneError: its asset has gone in the meantime.
            ReusedKeyError: the client's key means a job with another body.
            QuotaError: the owner has `max_active` jobs that have not ended.
        """
        job = replace(job, owner=self.owner or "")
        row: dict[str, object] = {c.name: getattr(job, c.name) for c in t.jobs.columns if c.name not in HIDDEN}
        row |= {"lost_stages": []}
        with self.writing() as connection:
            alive = (t.assets.c.id == job.asset_id) & t.assets.c.deleted_at.is_(None)
            if connection.execute(sa.select(t.assets.c.id).where(alive)).one_or_none() is None:
                raise GoneError(f"asset {job.asset_id} was deleted or has expired; upload it again")
            if client_key is None:
                self._require_quota(connection, max_active)
                connection.execute(t.jobs.insert().values(**row))
            else:
                if self.owner:
                    client_key = replace(client_key, key=f"{self.owner}:{client_key.key}")
                self._free_key(connection, client_key)
                row |= {"client_key": client_key.key, "body_sha256": client_key.body_sha256}
                if not insert_new(connection, t.jobs, row, unique="client_key"):
                    return read_job(connection, _same_job(connection, client_key)), False
                self._require_quota(connection, max_active, counted=1)
            note(connection, job.id, "accepted", at=job.created_at, request_id=job.request_id)
            add_stages(connection, job.id, stages)
            connection.execute(t.outbox.insert().values(job_id=job.id, attempt=job.attempt, created_at=job.created_at))
            return read_job(connection, job.id), True

    def _require_quota(self, connection: sa.Connection, max_active: int | None, *, counted: int = 0) -> None:
        if max_active is None:
            return
        if connection.dialect.name == "postgresql":  # one owner's jobs are counted one after another
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(sa.func.hashtext(self.owner or ""))))
        active = t.jobs.c.state.in_(ACTIVE) & (t.jobs.c.owner == (self.owner or ""))
        found = connection.execute(sa.select(sa.func.count()).where(active)).scalar_one() - counted
        if found >= max_active:
            raise QuotaError(f"{found} of your jobs have not ended, {max_active} are allowed; wait for one, or cancel")

    def _free_key(self, connection: sa.Connection, client_key: ClientKey) -> None:
        if client_key.expires_s is not None:
            old = (t.jobs.c.client_key == client_key.key) & (t.jobs.c.created_at < self.clock() - client_key.expires_s)
            connection.execute(t.jobs.update().where(old).values(client_key=None))

    def stage_seconds(self, stage: JobType, *, limit: int = 50) -> list[float]:
        """How long a stage took lately where it was really run [s]."""
        ran = (t.stages.c.name == stage) & (t.stages.c.state == "succeeded") & t.stages.c.cached.is_(False)
        columns = (t.stages.c.started_at, t.stages.c.finished_at)
        query = sa.select(*columns).where(ran).order_by(t.stages.c.finished_at.desc()).limit(limit)
        with self.reading() as connection:
            return [row.finished_at - row.started_at for row in connection.execute(query)]

    def stage_bytes(self, stage: JobType, *, limit: int = 50) -> list[int]:
        """How much a stage made lately, job by job."""
        total = sa.func.sum(t.artifacts.c.bytes)
        newest = sa.func.max(t.artifacts.c.created_at).desc()
        query = sa.select(total).where(t.artifacts.c.stage == stage).group_by(t.artifacts.c.job_id)
        with self.reading() as connection:
            return [int(value) for value in connection.execute(query.order_by(newest).limit(limit)).scalars()]

    @patient
    def job(self, job_id: str) -> JobRecord:
        """One job with its stages.

        Raises:
            NotFoundError, GoneError: there is none, or its record has expired.
        """
        with self.reading() as connection:
            return self._read_job(connection, job_id)

    def _read_job(self, connection: sa.Connection, job_id: str) -> JobRecord:
        try:
            job = read_job(connection, job_id)
        except NotFoundError:
            tomb = (t.tombstones.c.id == job_id) & self.mine(t.tombstones)
            if connection.execute(sa.select(t.tombstones.c.id).where(tomb)).one_or_none() is not None:
                raise GoneError(f"the record of job {job_id} has expired; create it again") from None
            raise
        if self.owner is not None and job.owner != self.owner:
            raise NotFoundError(f"there is no job {job_id}")
        return job

    def job_log(self, job_id: str, *, after: int = 0, limit: int = 100) -> list[LogLine]:
        """What happened to a job, oldest first.

        Raises:
            NotFoundError, GoneError: there is none, or its record has expired.
        """
        with self.reading() as connection:
            self._read_job(connection, job_id)
            return lines(connection, job_id, after=after, limit=limit)

    def job_versions(self, job_ids: list[str]) -> dict[str, tuple[int, bool]]:
        """Version of each job, and whether it has ended; none of those that are gone."""
        columns = (t.jobs.c.id, t.jobs.c.version, t.jobs.c.state)
        found = {}
        with self.reading() as connection:
            for start in range(0, len(job_ids), 500):  # SQLite takes 999 values a statement in old builds
                query = sa.select(*columns).where(t.jobs.c.id.in_(job_ids[start : start + 500]))
                for row in connection.execute(query):
                    found[row.id] = (row.version, JobState(row.state) not in ACTIVE)
        return found

    def run_seconds(self, *, limit: int = 50) -> list[float]:
        """How long jobs lately took a worker, from start to end [s]."""
        ran = (t.jobs.c.state == JobState.SUCCEEDED) & t.jobs.c.started_at.is_not(None)
        columns = (t.jobs.c.started_at, t.jobs.c.finished_at)
        query = sa.select(*columns).where(ran).order_by(t.jobs.c.finished_at.desc()).limit(limit)
        with self.reading() as connection:
            return [row.finished_at - row.started_at for row in connection.execute(query)]

    def jobs(
        self,
        *,
        state: JobState | None = None,
        job_type: JobType | None = None,
        before: str | None = None,
        limit: int = 20,
    ) -> list[JobRecord]:
        """Jobs, newest first, those older than the id `before`."""
        query = sa.select(t.jobs).where(self.mine(t.jobs)).order_by(t.jobs.c.id.desc()).limit(limit)
        if state is not None:
            query = query.where(t.jobs.c.state == state)
        if job_type is not None:
            query = query.where(t.jobs.c.type == job_type)
        if before is not None:
            query = query.where(t.jobs.c.id < before)
        with self.reading() as connection:
            rows = connection.execute(query).all()
            wanted = t.stages.c.job_id.in_([row.id for row in rows])
            stages: dict[str, list[StageRecord]] = {}
            for row in connection.execute(sa.select(t.stages).where(wanted).order_by(t.stages.c.position)):
                stages.setdefault(row.job_id, []).append(_stage(row))
        return [_job(row, tuple(stages.get(row.id, ()))) for row in rows]

    def look(self, job_id: str) -> tuple[JobRecord, int | None, list[ArtifactRecord]]:
        """A job, its place in the queue and what it offers so far, all of one moment: what a poll asks.

        Raises:
            NotFoundError, GoneError: there is none, or its record has expired.
        """
        with self.reading() as connection:
            job = self._read_job(connection, job_id)
            return job, *_standing(connection, job)

    def standing(self, job: JobRecord) -> tuple[int | None, list[ArtifactRecord]]:
        """How many jobs of its queue were there before a job, None once it has begun; and what it offers so far."""
        with self.reading() as connection:
            return _standing(connection, job)

    def count_active(self) -> int:
        """How many jobs have not ended."""
        active = t.jobs.c.state.in_(ACTIVE) & self.mine(t.jobs)
        with self.reading() as connection:
            return connection.execute(sa.select(sa.func.count()).where(active)).scalar_one()

    def count_jobs(self, state: JobState) -> int:
        """How many jobs are in a state."""
        with self.reading() as connection:
            return connection.execute(sa.select(sa.func.count()).where(t.jobs.c.state == state)).scalar_one()

    def cancel(self, job_id: str) -> JobRecord:
        """Ask a job to stop. One that no worker holds is canceled at once; asking again changes nothing.

        Raises:
            ConflictError: it has ended otherwise.
        """
        with self.writing() as connection:
            job = self._read_job(connection, job_id)
            if job.state in {JobState.CANCELING, JobState.CANCELED}:
                return job
            if not move(connection, job_id, JobState.CANCELING):
                raise ConflictError(f"job {job_id} has {job.state}; only a queued or running job can be canceled")
            note(connection, job_id, "asked to stop", at=self.clock())
            held = connection.execute(sa.select(t.jobs.c.lease_owner).where(t.jobs.c.id == job_id)).scalar_one()
            if held is None:
                end(connection, job_id, JobState.CANCELED, now=self.clock())
            return read_job(connection, job_id)

    # -- artefacts

    @patient
    def artifacts_of(self, job_id: str) -> list[ArtifactRecord]:
        """What a job offers so far, in the order it was made."""
        with self.reading() as connection:
            return _artifacts_of(connection, job_id)

    def artifact(self, artifact_id: str) -> ArtifactRecord:
        """One artefact.

        Raises:
            NotFoundError, GoneError: there is none, or it has expired.
        """
        with self.reading() as connection:
            query = sa.select(t.artifacts).where(t.artifacts.c.id == artifact_id)
            if self.owner is not None:
                query = query.join(t.jobs, t.jobs.c.id == t.artifacts.c.job_id).where(self.mine(t.jobs))
            row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFoundError(f"there is no artefact {artifact_id}")
        artifact = ArtifactRecord(**row._mapping)
        if artifact.expires_at <= self.clock():
            raise GoneError(f"artefact {artifact_id} has expired; run the job again")
        return artifact

    def check(self) -> None:
        """Touch the database; what is wrong with it passes through."""
        with self.reading() as connection:
            connection.execute(sa.select(1))


def move(connection: sa.Connection, job_id: str, target: JobState, **values: object) -> bool:
    """Compare and set: bring a job to a state that its present one allows, or tell that it does not."""
    allowed = (t.jobs.c.id == job_id) & t.jobs.c.state.in_(states_before(target))
    change = t.jobs.update().where(allowed).values(state=target, version=t.jobs.c.version + 1, **values)
    return connection.execute(change).rowcount == 1


def end(connection: sa.Connection, job_id: str, target: JobState, *, now: float, **values: object) -> bool:
    """Bring a job to a final state: lease given up, message withdrawn, stages closed."""
    if not move(connection, job_id, target, finished_at=now, lease_owner=None, lease_until=None, **values):
        return False
    of_job = t.stages.c.job_id == job_id
    left = {JobState.FAILED: "failed"}.get(target, "canceled")
    connection.execute(
        t.stages.update().where(of_job & (t.stages.c.state == "running")).values(state=left, finished_at=now)
    )
    connection.execute(t.stages.update().where(of_job & (t.stages.c.state == "queued")).values(state="canceled"))
    connection.execute(t.outbox.delete().where(t.outbox.c.job_id == job_id))
    level: Level = "error" if target == JobState.FAILED else "info"
    detail = {"code": values["error_code"], "detail": values["error_message"]} if "error_code" in values else {}
    note(connection, job_id, str(target), at=now, level=level, **detail)  # type: ignore[arg-type]
    announce(connection, job_id, target, now=now)
    count(connection, "jobs", str(target))
    return True


def add_stages(connection: sa.Connection, job_id: str, names: tuple[JobType, ...]) -> None:
    """Write a job's stages, all queued."""
    rows = [
        {"job_id": job_id, "name": name, "position": i, "state": "queued", "progress": 0.0, "cached": False}
        for i, name in enumerate(names)
    ]
    connection.execute(t.stages.insert(), rows)


def _standing(connection: sa.Connection, job: JobRecord) -> tuple[int | None, list[ArtifactRecord]]:
    begun = any(stage.state != "queued" for stage in job.stages)  # the usual poll of a waiting job asks once less
    return _position(connection, job), _artifacts_of(connection, job.id) if begun else []


def _position(connection: sa.Connection, job: JobRecord) -> int | None:
    if job.state != JobState.QUEUED:
        return None
    return connection.execute(_NUM_AHEAD, {"queue": job.queue, "id": job.id}).scalar_one()


def _artifacts_of(connection: sa.Connection, job_id: str) -> list[ArtifactRecord]:
    return [ArtifactRecord(**row._mapping) for row in connection.execute(_ARTIFACTS, {"id": job_id})]


def read_job(connection: sa.Connection, job_id: str) -> JobRecord:
    """One job with its stages, as this transaction sees it."""
    row = connection.execute(_JOB, {"id": job_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no job {job_id}")
    return _job(row, tuple(_stage(stage) for stage in connection.execute(_STAGES, {"id": job_id})))


def _same_job(connection: sa.Connection, client_key: ClientKey) -> str:
    query = sa.select(t.jobs.c.id, t.jobs.c.body_sha256).where(t.jobs.c.client_key == client_key.key)
    row = connection.execute(query).one()
    if row.body_sha256 != client_key.body_sha256:
        raise ReusedKeyError(f"the same key was sent with another body before, for job {row.id}; use a new key")
    return str(row.id)


def _asset(row: sa.Row[tuple[object, ...]]) -> AssetRecord:
    values = dict(row._mapping)
    del values["live_fingerprint"], values["bytes"]
    values["parts"] = tuple(AssetPart(**part) for part in values["parts"])
    values["prepared"] = values["prepared"] and AssetPart(**values["prepared"])
    return AssetRecord(**values)


def _stage(row: sa.Row[tuple[object, ...]]) -> StageRecord:
    values: Mapping[str, object] = {k: v for k, v in row._mapping.items() if k not in {"job_id", "position"}}
    return StageRecord(**values)  # type: ignore[arg-type]


def _job(row: sa.Row[tuple[object, ...]], stages: tuple[StageRecord, ...]) -> JobRecord:
    values = {k: v for k, v in row._mapping.items() if k not in HIDDEN}
    return JobRecord(**values | {"stages": stages, "state": JobState(values["state"])})
