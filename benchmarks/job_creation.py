"""How long it takes until a job is accepted and stored, synced to disk, beside a worker that is busy on one thread."""

import json

from benchmarks._load import busy_service, load

TARGET_MS = 50.0
RATE = 20
SECONDS = 20


def run() -> dict[str, object]:
    with busy_service() as (url, _, asset):
        body = json.dumps({"type": "voxelize", "asset_id": asset})
        load(url + "/v1/jobs", rate=RATE, connections=2, seconds=3, body=body)
        measured = load(url + "/v1/jobs", rate=RATE, connections=2, seconds=SECONDS, body=body)
    return measured.figures(target_ms=TARGET_MS)
