"""The look of a model reaches the GLB of a job: through the confined parser, the store and the real stages."""

import asyncio
from pathlib import Path

from jobs.storage.assets import add_asset
from jobs.storage.parser_process import ParseRequest, parse
from tests.formats import artists
from tests.formats.artists import document_of
from tests.formats.test_artists_looks import looks, without_motion
from tests.rows import asset_row, stored_part
from tests.worker.test_attempt import content, run, with_spectrum
from worker.runtime import Runtime


def test_a_job_s_glb_differs_from_the_upload_by_its_motion_only(runtime: Runtime, tmp_path: Path) -> None:
    folder = tmp_path / "upload"
    folder.mkdir()
    (folder / "tree.glb").write_bytes(artists.wooded().glb())
    request = ParseRequest(
        kind="mesh",
        names=("tree.glb",),
        paths=(folder / "tree.glb",),
        prepared=folder / "prepared",
        memory_bytes=runtime.settings.parser_memory_bytes,
        cpu_s=runtime.settings.parser_cpu_s,
    )
    answer = asyncio.run(parse(request, runtime.settings))
    assert answer.code is None, answer
    row = asset_row(stored_part(runtime.artifacts, folder / "prepared"), now=runtime.store.clock())
    lease = with_spectrum(runtime, add_asset(runtime.store, row)[0], tmp_path, formats=["glb-morph"])
    run(runtime, lease)
    written = document_of(content(runtime, lease.job.id, "tree-morph.glb"))
    assert without_motion(written) == looks(document_of(artists.wooded().glb()))
    assert written.root["animations"][0]["channels"]
