from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

import jobs.database.migrations
from jobs.database.engine import open_engine
from jobs.database.migrations import migrate, step_back
from jobs.database.tables import HEAD, metadata
from jobs.lifecycle.attempts import claim, succeed
from jobs.storage.assets import add_asset
from jobs.store import Store
from tests.jobs.conftest import add_job, make_asset


def test_the_revisions_make_the_tables(store: Store) -> None:
    with store.reading() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []


def test_head_is_the_newest_revision() -> None:
    assert ScriptDirectory(str(Path(jobs.database.migrations.__file__).parent)).get_current_head() == HEAD


def test_many_may_migrate_at_once(tmp_path: Path) -> None:
    engines = [open_engine(f"sqlite:///{tmp_path / 'new' / 'jobs.sqlite'}") for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(migrate, engines))
    for engine in engines:
        with engine.connect() as connection:
            assert connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar_one() == HEAD
        engine.dispose()


def test_every_revision_can_be_taken_back_and_done_again(store: Store) -> None:
    job = add_job(store, add_asset(store, make_asset(store.clock()))[0])
    for revision in ("0004", "0003", "0002", "0001"):
        step_back(store.engine, revision)
    with store.engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT id FROM jobs").scalar_one() == job.id
    migrate(store.engine)
    assert store.job(job.id) == job
    step_back(store.engine, "base")
    assert sa.inspect(store.engine).get_table_names() == ["alembic_version"]
    migrate(store.engine)
    with store.reading() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []


def test_old_code_goes_on_with_newer_tables(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    Store.open(url).close()
    engine = sa.create_engine(url)
    with engine.begin() as connection:  # as the next version's migration does: it only adds
        connection.execute(sa.text("UPDATE alembic_version SET version_num = '9999'"))
        connection.execute(sa.text("ALTER TABLE jobs ADD COLUMN later TEXT"))
        connection.execute(sa.text("CREATE TABLE later (id TEXT)"))
    engine.dispose()
    store = Store.open(url)
    asset = add_asset(store, make_asset(store.clock()))[0]
    job = add_job(store, asset)
    lease = claim(store, job.id, 1, owner="old", lease_s=60)
    assert lease is not None
    assert succeed(store, lease) == "succeeded"
    store.close()


def test_only_the_owner_of_the_process_reads_the_database(tmp_path: Path) -> None:
    path = tmp_path / "state" / "jobs.sqlite"
    Store.open(f"sqlite:///{path}").close()
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.parent.stat().st_mode & 0o777 == 0o700
