import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa

from jobs.clients.keys import create_key, find_key
from jobs.database.engine import open_engine
from jobs.database.tables import REVISION, make_tables
from jobs.errors import SchemaError
from jobs.lifecycle.attempts import claim, succeed
from jobs.storage.assets import add_asset
from jobs.store import Store
from tests.jobs.conftest import add_job, make_asset


@pytest.mark.parametrize("attempt", range(8))
def test_many_may_make_the_tables_at_once(tmp_path: Path, attempt: int) -> None:
    engines = [open_engine(f"sqlite:///{tmp_path / 'new' / 'jobs.sqlite'}") for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(make_tables, engines))
    for engine in engines:
        with engine.connect() as connection:
            assert connection.exec_driver_sql("SELECT count(*) FROM schema_revision").scalar_one() == 1
        engine.dispose()


def test_a_second_store_leaves_the_locks_of_the_first(tmp_path: Path) -> None:
    """A process that closes a file loses its locks on it: another program then deletes the log, and what is written."""
    url = f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    with open_engine(url).connect() as connection:
        connection.exec_driver_sql("CREATE TABLE t (x)")
        connection.commit()
        open_engine(url)
        program = "import sqlite3; sqlite3.connect('jobs.sqlite').execute('CREATE TABLE u (x)').connection.close()"
        subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
        assert (tmp_path / "jobs.sqlite-wal").exists()


@pytest.mark.parametrize("earlier", ["DROP TABLE schema_revision", "UPDATE schema_revision SET number = 0"])
def test_tables_of_an_earlier_revision_are_refused(tmp_path: Path, earlier: str) -> None:
    url = f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    Store.open(url).close()
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        connection.execute(sa.text(earlier))
    engine.dispose()
    with pytest.raises(SchemaError, match=rf"revision 0, this program needs {REVISION}; .* another state folder"):
        Store.open(url)


def test_old_code_goes_on_with_newer_tables(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'jobs.sqlite'}"
    Store.open(url).close()
    engine = sa.create_engine(url)
    with engine.begin() as connection:  # as the next release does: it only adds
        connection.execute(sa.text("UPDATE schema_revision SET number = 9999"))
        connection.execute(sa.text("ALTER TABLE jobs ADD COLUMN later TEXT"))
        connection.execute(sa.text("CREATE TABLE later (id TEXT)"))
    engine.dispose()
    store = Store.open(url)
    job = add_job(store, add_asset(store, make_asset(store.clock()))[0])
    lease = claim(store, job.id, 1, owner="old", lease_s=60)
    assert lease is not None
    assert succeed(store, lease) == "succeeded"
    key, _ = create_key(store, name="new", scopes=("read", "later"))  # type: ignore[arg-type]
    assert find_key(store, id=key.id) == key
    store.close()
