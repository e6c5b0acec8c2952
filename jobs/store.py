"""The job store: jobs, stages and artifacts, in SQLite or PostgreSQL through SQLAlchemy.

Other rows have their own modules (`assets.py`, `uploads.py`, `webhooks.py`, `keys.py`). A worker's changes to a
running job are in `attempts.py`, those of the housekeeper in `maintenance.py`.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from typing import Any

import sqlalchemy as sa
from ulid import ULID

from jobs.database import tables as t
from jobs.database.engine import insert_new, open_engine
from jobs.database.retry import retry_while_unavailable
from jobs.database.tables import make_tables
from jobs.errors import ConflictError, GoneError, NotFoundError, QuotaError
from jobs.lifecycle import rows
from jobs.records import ArtifactRecord, ClientKey, JobRecord
from jobs.states import ACTIVE, JobState, JobType


def new_id() -> str:
    """Return a new ULID; ids sort by their time of creation."""
    return str(ULID())


class Store:
    """Access of one process to the job store; with an owner, restricted to the owner's rows.

    Reading a row by its id raises NotFoundError if it never existed, and GoneError if it existed once.
    """

    def __init__(self, engine: sa.Engine, *, clock: Callable[[], float] = time.time, owner: str | None = None) -> None:
        self.engine = engine
        self.clock = clock
        self.owner = owner
        self.patience_s = 0.0  # how long functions marked @retry_while_unavailable wait for an unavailable database

    def for_owner(self, owner: str) -> "Store":
        """Restrict the store to the rows of one owner."""
        return Store(self.engine, clock=self.clock, owner=owner)

    def owned(self, table: sa.Table) -> sa.ColumnElement[bool]:
        """Restrict a query to the owner's rows."""
        return sa.true() if self.owner is None else table.c.owner == self.owner

    @classmethod
    def open(cls, url: str, *, clock: Callable[[], float] = time.time) -> "Store":
        """Connect, and create the tables if there are none."""
        engine = open_engine(url)
        make_tables(engine)
        return cls(engine, clock=clock)

    def close(self) -> None:
        """Drop the pooled connections."""
        self.engine.dispose()

    @contextmanager
    def reading(self, *, of_one_moment: bool = False) -> Iterator[sa.Connection]:
        """Open a read-only transaction; on SQLite it blocks no writer and always sees one snapshot."""
        needs_level = of_one_moment and self.engine.dialect.name != "sqlite"
        options = {"isolation_level": "REPEATABLE READ"} if needs_level else {}
        with self.engine.connect().execution_options(reading=True, **options) as connection, connection.begin():
            yield connection

    @contextmanager
    def writing(self) -> Iterator[sa.Connection]:
        """Open a transaction that may write."""
        with self.engine.begin() as connection:
            yield connection

    def lock_owner(self, connection: sa.Connection) -> None:
        """Serialize this owner's transactions that check a quota."""
        if connection.dialect.name == "postgresql":  # SQLite serializes writers anyway
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(sa.func.hashtext(self.owner or ""))))

    def add_job(
        self,
        job: JobRecord,
        *,
        stages: tuple[JobType, ...],
        client_key: ClientKey | None = None,
        max_active: int | None = None,
    ) -> tuple[JobRecord, bool]:
        """Store a new job, its stages and message in one transaction; return whether it is new.

        Raises:
            GoneError: its asset was deleted in the meantime.
            ReusedKeyError: the client's key was used for another body.
            QuotaError: the owner already has `max_active` unfinished jobs.
        """
        job = replace(job, owner=self.owner or "")
        row = {k: v for k, v in asdict(job).items() if k != "stages"} | {"lost_stages": []}
        with self.writing() as connection:
            alive = (t.assets.c.id == job.asset_id) & t.assets.c.deleted_at.is_(None)
            if connection.execute(sa.select(t.assets.c.id).where(alive)).one_or_none() is None:
                raise GoneError(f"asset {job.asset_id} was deleted or has expired; upload it again")
            if client_key is None:
                self._require_quota(connection, max_active)
                connection.execute(t.jobs.insert().values(**row))
            else:
                client_key = self._own_key(client_key)
                expired = (t.jobs.c.client_key == client_key.key) & (
                    t.jobs.c.created_at < self.clock() - client_key.expires_s
                )
                connection.execute(t.jobs.update().where(expired).values(client_key=None))
                row |= {"client_key": client_key.key, "body_sha256": client_key.body_sha256}
                if not insert_new(connection, t.jobs, row, unique="client_key"):
                    return rows.read_job(connection, rows.same_job(connection, client_key)), False
                self._require_quota(connection, max_active, counted=1)
            begun = {"job_id": job.id, "state": "queued", "progress": 0.0, "cached": False}
            connection.execute(t.stages.insert(), [begun | {"name": n, "position": i} for i, n in enumerate(stages)])
            connection.execute(t.outbox.insert().values(job_id=job.id, attempt=job.attempt, created_at=job.created_at))
            return rows.read_job(connection, job.id), True

    def job_of_key(self, client_key: ClientKey) -> JobRecord | None:
        """Return the job that was created with a client's key, or None.

        Raises:
            ReusedKeyError: that job's request had another body.
        """
        client_key = self._own_key(client_key)
        fresh = t.jobs.c.created_at >= self.clock() - client_key.expires_s
        this = (t.jobs.c.client_key == client_key.key) & fresh
        with self.reading() as connection:
            if connection.execute(sa.select(t.jobs.c.id).where(this)).one_or_none() is None:
                return None
            return rows.read_job(connection, rows.same_job(connection, client_key))

    def _own_key(self, client_key: ClientKey) -> ClientKey:
        return replace(client_key, key=f"{self.owner}:{client_key.key}") if self.owner else client_key

    def _require_quota(self, connection: sa.Connection, max_active: int | None, *, counted: int = 0) -> None:
        if max_active is None:
            return
        self.lock_owner(connection)
        active = t.jobs.c.state.in_(ACTIVE) & (t.jobs.c.owner == (self.owner or ""))
        matches = connection.execute(sa.select(sa.func.count()).where(active)).scalar_one() - counted
        if matches >= max_active:
            raise QuotaError(
                f"{matches} of your jobs have not ended, {max_active} are allowed; wait for one, or cancel"
            )

    @retry_while_unavailable
    def job(self, job_id: str) -> JobRecord:
        """Return one job with its stages."""
        with self.reading() as connection:
            return self._read_job(connection, job_id)

    def _read_job(self, connection: sa.Connection, job_id: str) -> JobRecord:
        try:
            job = rows.read_job(connection, job_id)
        except NotFoundError:
            tomb = (t.tombstones.c.id == job_id) & self.owned(t.tombstones)
            if connection.execute(sa.select(t.tombstones.c.id).where(tomb)).one_or_none() is not None:
                raise GoneError(f"job {job_id} was deleted or has expired; create it again") from None
            raise
        if self.owner is not None and job.owner != self.owner:
            raise NotFoundError(f"there is no job {job_id}")
        return job

    def job_versions(self, job_ids: list[str]) -> dict[str, int]:
        """Return the version of each job that exists."""
        query = sa.select(t.jobs.c.id, t.jobs.c.version).where(t.jobs.c.id.in_(job_ids))
        with self.reading() as connection:
            return {row.id: row.version for row in connection.execute(query)}

    def jobs(
        self,
        chosen: Mapping[str, str | None] | None = None,
        *,
        since: float | None = None,
        before: str | None = None,
        limit: int = 20,
    ) -> list[JobRecord]:
        """List jobs with the chosen column values, newest first: created from `since` on, with ids below `before`."""
        query = sa.select(t.jobs).where(self.owned(t.jobs)).order_by(t.jobs.c.id.desc()).limit(limit)
        for name, value in (chosen or {}).items():
            if value is not None:
                query = query.where(t.jobs.c[name] == value)
        if since is not None:
            query = query.where(t.jobs.c.created_at >= since)
        if before is not None:
            query = query.where(t.jobs.c.id < before)
        with self.reading() as connection:
            matches = connection.execute(query).all()
            wanted = t.stages.c.job_id.in_([row.id for row in matches])
            stages: dict[str, list[sa.Row[Any]]] = {}
            for stage in connection.execute(sa.select(t.stages).where(wanted).order_by(t.stages.c.position)):
                stages.setdefault(stage.job_id, []).append(stage)
        return [rows.job_of(row, stages.get(row.id, [])) for row in matches]

    def positions_and_artifacts(self, page: Sequence[JobRecord]) -> dict[str, tuple[int | None, list[ArtifactRecord]]]:
        """Return each job's number of jobs before it in its queue (None once started) and its artifacts so far.

        Owners take turns, as in `maintenance.messages_to_send`.
        """
        positions: dict[str, int] = {}
        offered: dict[str, list[ArtifactRecord]] = {}
        with self.reading() as connection:
            waiting = {job.id: job.queue for job in page if job.state == JobState.QUEUED}
            if waiting:
                queued = t.jobs.c.queue.in_(set(waiting.values())) & (t.jobs.c.state == JobState.QUEUED)
                place = sa.func.row_number().over(partition_by=(t.jobs.c.queue, t.jobs.c.owner), order_by=t.jobs.c.id)
                placed = sa.select(t.jobs.c.id, t.jobs.c.queue, place.label("place")).where(queued).subquery()
                turn = sa.func.row_number().over(partition_by=placed.c.queue, order_by=(placed.c.place, placed.c.id))
                turns = sa.select(placed.c.id, turn.label("turn")).subquery()
                wanted = sa.select(turns).where(turns.c.id.in_(waiting))
                positions = {row.id: row.turn - 1 for row in connection.execute(wanted)}
            begun = [job.id for job in page if any(stage.state != "queued" for stage in job.stages)]
            if begun:
                artifacts = sa.select(t.artifacts).where(t.artifacts.c.job_id.in_(begun)).order_by(t.artifacts.c.id)
                for row in connection.execute(artifacts):
                    offered.setdefault(row.job_id, []).append(t.record_of(ArtifactRecord, row))
        return {job.id: (positions.get(job.id), offered.get(job.id, [])) for job in page}

    def cancel(self, job_id: str) -> JobRecord:
        """Cancel a job, at once if no worker runs it. Idempotent.

        Raises:
            ConflictError: the job has ended in another way.
        """
        with self.writing() as connection:
            job = self._read_job(connection, job_id)
            if job.state in {JobState.CANCELING, JobState.CANCELED}:
                return job
            if not rows.change_state(connection, job_id, JobState.CANCELING):
                raise ConflictError(f"job {job_id} has {job.state}; only a queued or running job can be canceled")
            holder = connection.execute(sa.select(t.jobs.c.lease_owner).where(t.jobs.c.id == job_id)).scalar_one()
            if holder is None:
                rows.end_job(connection, job_id, JobState.CANCELED, now=self.clock())
            return rows.read_job(connection, job_id)

    def delete_job(self, job_id: str) -> None:
        """Delete a job that has ended and the records of its files; retention deletes their bytes.

        Raises:
            ConflictError: the job has not ended.
        """
        with self.writing() as connection:
            job = self._read_job(connection, job_id)
            if not job.terminal:
                raise ConflictError(f"job {job_id} is {job.state}; cancel it, and delete it once it has ended")
            rows.delete_with_tombstones(connection, t.jobs.c.id == job_id, now=self.clock())

    @retry_while_unavailable
    def artifacts_of(self, job_id: str) -> list[ArtifactRecord]:
        """Return the artifacts of a job so far, in order of creation."""
        with self.reading() as connection:
            return [t.record_of(ArtifactRecord, row) for row in connection.execute(rows.ARTIFACTS, {"id": job_id})]

    def artifact(self, artifact_id: str) -> ArtifactRecord:
        """Return one artefact."""
        with self.reading() as connection:
            query = sa.select(t.artifacts).where(t.artifacts.c.id == artifact_id)
            if self.owner is not None:
                query = query.join(t.jobs, t.jobs.c.id == t.artifacts.c.job_id).where(self.owned(t.jobs))
            row = connection.execute(query).one_or_none()
        if row is None:
            raise NotFoundError(f"there is no artefact {artifact_id}")
        artifact = t.record_of(ArtifactRecord, row)
        if artifact.expires_at <= self.clock():
            raise GoneError(f"artefact {artifact_id} has expired; run the job again")
        return artifact
