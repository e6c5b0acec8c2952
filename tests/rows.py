"""Rows of the store as a running service has them: an asset that was read, a job that waits."""

from pathlib import Path
from typing import Any

from jobs.records import AssetPart, AssetRecord, JobRecord, UploadRecord
from jobs.states import JobState, JobType
from jobs.storage.artifacts import ArtifactStore, hash_file
from jobs.store import new_id


def asset_row(part: AssetPart, *, now: float, **values: Any) -> AssetRecord:
    """A mesh of one file; `values` in place of what it would have."""
    usual: dict[str, Any] = {"id": new_id(), "kind": "mesh", "fingerprint": part.sha256, "parts": (part,)}
    usual |= {"prepared": part, "summary": {}, "created_at": now, "expires_at": now + 1000}
    return AssetRecord(**usual | values)


def job_row(asset: AssetRecord, job_type: JobType = "diffuse", *, now: float, **values: Any) -> JobRecord:
    """A job of an asset; `values` in place of what it would have."""
    usual: dict[str, Any] = {"id": new_id(), "type": job_type, "state": JobState.QUEUED, "asset_id": asset.id}
    usual |= {"preset": "small", "seed": 0, "params": {}, "queue": "cpu", "created_at": now}
    return JobRecord(**usual | values)


def upload_row(upload_id: str, *, now: float, **values: Any) -> UploadRecord:
    """An upload of which nothing has come; `values` in place of what it would have."""
    usual: dict[str, Any] = {"id": upload_id, "state": "receiving", "filename": "tree", "options": {}, "length": 9}
    usual |= {"created_at": now, "expires_at": now + 1000}
    return UploadRecord(**usual | values)


def stored_part(artifacts: ArtifactStore, path: Path) -> AssetPart:
    """A file, its bytes put where bytes are."""
    digest, size = hash_file(path)
    artifacts.put(path, digest)
    return AssetPart(name=path.name, sha256=digest, bytes=size)
