"""Intermediate results of a stage that other jobs and the API reuse; like stages, they are stored by key.

An entry names its input files as `source`: it is deleted with them, and does not retain them.
"""

import json
from collections.abc import Iterable
from dataclasses import asdict
from hashlib import sha256
from importlib.metadata import version

from jobs.database import tables as t
from jobs.database.engine import upsert
from jobs.database.retry import retry_while_unavailable
from jobs.lifecycle.attempts import cached_stage, touch_blob
from jobs.records import JobRecord, OutputFile
from jobs.storage.artifacts import ArtifactStore
from jobs.storage.stage_files import MESH_BUNDLE, SPECTRUM, STAGE_VERSION
from jobs.store import Store

RESULT_SOURCES = {"rig": (SPECTRUM, MESH_BUNDLE)}
"""Input files of each result."""


def result_key(name: str, job: JobRecord, sources: Iterable[str], *params: object) -> str:
    """Return the sha256 of all inputs of a result or stage: hashes of its sources, parameters, owner and code.

    The owner is included, since a cache hit would reveal to one owner what another has uploaded.
    """
    meaning = [name, STAGE_VERSION, version("dynamictree"), list(sources), *params, job.owner]
    return sha256(json.dumps(meaning, sort_keys=True).encode()).hexdigest()


def find_stored(store: Store, artifacts: ArtifactStore, key: str) -> tuple[OutputFile, ...] | None:
    """Find the files of a stage or result that any job made from the same inputs; None if bytes are missing."""
    files = cached_stage(store, key)
    for file in files or ():
        touch_blob(store, file.sha256, file.bytes)
    return files if all(artifacts.exists(file.sha256) for file in files or ()) else None


@retry_while_unavailable
def remember_intermediate(
    store: Store, key: str, name: str, file: OutputFile, sources: Iterable[OutputFile], *, owner: str = ""
) -> None:
    """Cache a result of an owner's job, or note that it was used now."""
    files = [asdict(file), *({"name": each.name, "sha256": each.sha256, "source": True} for each in sources)]
    with store.writing() as connection:
        entry = {"key": key, "stage": name, "files": files, "owner": owner, "bytes": file.bytes}
        upsert(connection, t.stage_cache, entry | {"used_at": store.clock()})
