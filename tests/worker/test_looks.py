"""The look of a model reaches the GLB of a job: through the confined parser, the store and the real stages."""

import asyncio
from pathlib import Path

from jobs.storage.assets import add_asset
from jobs.storage.parser_process import parse
from tests.formats import artists
from tests.formats.artists import document_of
from tests.formats.looks import looks
from tests.jobs.test_parser import request_of
from tests.rows import asset_row, stored_part
from tests.worker.test_attempt import content, run, with_spectrum
from worker.runtime import Runtime


def test_a_job_s_glb_differs_from_the_upload_by_its_motion_only(runtime: Runtime, tmp_path: Path) -> None:
    folder = tmp_path / "upload"
    folder.mkdir()
    (folder / "tree.glb").write_bytes(artists.wooded().glb())
    request = request_of(runtime.settings, folder / "tree.glb", "tree.glb")
    answer = asyncio.run(parse(request, runtime.settings))
    assert answer.code is None, answer
    row = asset_row(stored_part(runtime.artifacts, folder / "prepared"), now=runtime.store.clock())
    lease = with_spectrum(runtime, add_asset(runtime.store, row)[0], tmp_path, formats=["glb"])
    run(runtime, lease)
    written = document_of(content(runtime, lease.job.id, "tree.glb"))
    after, before = looks(written), looks(document_of(artists.wooded().glb()))
    seen = ("materials", "textures", "samplers", "images", "cameras", "extensions")
    assert [after[name] for name in seen] == [before[name] for name in seen]
    assert [node["name"] for node in after["nodes"]][:4] == [node["name"] for node in before["nodes"]]
    for primitive in (one for node in after["nodes"] if "mesh" in node for one in node["mesh"]["primitives"]):
        del primitive["attributes"]["JOINTS_0"], primitive["attributes"]["WEIGHTS_0"]
    meshes, sent = ([node["mesh"] for node in look["nodes"] if "mesh" in node] for look in (after, before))
    assert meshes == sent
    assert after["animations"][0]["channels"]
