"""What a product tells of its error is in the manifest, also where it comes from the cache."""

from fastapi.testclient import TestClient

from jobs.lifecycle.attempts import cached_stage, publish_stage, start_stage
from jobs.records import AssetRecord, OutputFile
from service.services import Services
from tests.service.conftest import hold
from tests.service.test_jobs import create

FACTS = {"num_targets": 8, "rms_error_m": 0.0086, "max_error_m": 0.091}


def test_facts_reach_the_manifest_and_the_cache(client: TestClient, asset: AssetRecord, services: Services) -> None:
    job = create(client, asset)
    lease = hold(services, str(job["id"]))
    output = OutputFile(name="a.glb", media_type="model/gltf-binary", sha256="a" * 64, bytes=1, facts=FACTS)
    silent = OutputFile(name="b.glb", media_type="model/gltf-binary", sha256="b" * 64, bytes=1)
    warned = {"warnings": ["26 of 60 photos have a camera"]}
    report = OutputFile(name="report.json", media_type="application/json", sha256="c" * 64, bytes=1, facts=warned)
    start_stage(services.store, lease, "voxelize")
    files = (output, silent, report)
    publish_stage(services.store, lease, "voxelize", files, key="k" * 64, cached=False, retention_s=1000)
    manifest = client.get(f"/v1/jobs/{job['id']}/artifacts").json()
    assert [artifact["facts"] for artifact in manifest["artifacts"]] == [FACTS, {}, {}]
    assert client.get(f"/v1/jobs/{job['id']}").json()["result"]["warnings"] == warned["warnings"]
    assert cached_stage(services.store, "k" * 64) == files
