"""Results that a stage computes on its way and that other jobs and the API use again: stored as stages are, by key.

An entry names the files that it was computed from as `source`: it is forgotten with them, and does not retain them.
"""

import json
from collections.abc import Iterable
from dataclasses import asdict
from hashlib import sha256
from importlib.metadata import version

from jobs.database import tables as t
from jobs.database.engine import upsert
from jobs.database.retry import patient
from jobs.lifecycle.attempts import cached_stage, touch_blob
from jobs.records import JobRecord, OutputFile
from jobs.storage.artifacts import ArtifactStore
from jobs.storage.stage_files import MESH_BUNDLE, SPECTRUM, STAGE_VERSION
from jobs.store import Store

RESULT_SOURCES = {"rig": (SPECTRUM, MESH_BUNDLE)}
"""The files that each result is computed from."""


def result_key(name: str, job: JobRecord, sources: Iterable[str], *params: object) -> str:
    """sha256 over all that decides a result or a stage: the hashes of its sources, parameters, owner and code.

    The owner, since a hit would tell one owner what another has sent.
    """
    meaning = [name, STAGE_VERSION, version("dynamictree"), list(sources), *params, job.owner]
    return sha256(json.dumps(meaning, sort_keys=True).encode()).hexdigest()


def find_stored(store: Store, artifacts: ArtifactStore, key: str) -> tuple[OutputFile, ...] | None:
    """Files that any job made from the same inputs, of a stage or the one of a result, if all their bytes are there."""
    files = cached_stage(store, key)
    for file in files or ():
        touch_blob(store, file.sha256, file.bytes)
    return files if all(artifacts.exists(file.sha256) for file in files or ()) else None


@patient
def remember_intermediate(
    store: Store, key: str, name: str, file: OutputFile, sources: Iterable[OutputFile], *, owner: str = ""
) -> None:
    """Remember a result of an owner's job, and that it is used now."""
    files = [asdict(file), *({"name": each.name, "sha256": each.sha256, "source": True} for each in sources)]
    with store.writing() as connection:
        entry = {"key": key, "stage": name, "files": files, "owner": owner, "bytes": file.bytes}
        upsert(connection, t.stage_cache, entry | {"used_at": store.clock()})
