"""The viewer as a package of npm: packed, unpacked beside three.js, its example page shows a tree of a service."""

import json
import shutil
import subprocess
import tarfile
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from tests.browser.conftest import Viewer, web_server

WEB = Path(__file__).parents[2] / "web"
THREE = WEB / "vendor/three-0.187.0"


@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not there")
def test_the_packed_viewer_shows_a_tree(view: Callable[..., Viewer], url: str, job_id: str, tmp_path: Path) -> None:
    command = ["npm", "pack", "--json", "--pack-destination", str(tmp_path)]
    [packed] = json.loads(subprocess.run(command, cwd=WEB, check=True, capture_output=True).stdout)
    names = {file["path"] for file in packed["files"]}
    assert {"viewer.js", "client.js", "embed/dynamic-tree.js", "embed/example.html", "README.md"} <= names
    assert not [name for name in names if name.startswith(("vendor/", "page/", "examples/"))]
    modules = tmp_path / "site/node_modules"
    (modules / "@dynamictree").mkdir(parents=True)
    with tarfile.open(tmp_path / packed["filename"]) as archive:
        archive.extractall(modules / "@dynamictree", filter="data")
    package = (modules / "@dynamictree/package").rename(modules / "@dynamictree/viewer")
    for built, folder in ((THREE, modules / "three/build"), (THREE / "addons", modules / "three/examples/jsm")):
        shutil.copytree(built, folder)
    (tmp_path / "site/pages").mkdir()
    shutil.copy(package / "embed/example.html", tmp_path / "site/pages/index.html")
    for kind in ("surface", "modes"):
        spectrum = httpx.get(f"{url}/v1/jobs/{job_id}").json()["result"]["spectrum_id"]
        path = tmp_path / f"site/v1/spectra/{spectrum}/{kind}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(httpx.get(f"{url}/v1/spectra/{spectrum}/{kind}").content)
    with web_server(tmp_path / "site") as origin:
        viewer = view(700, 520)
        viewer.page.goto(f"{origin}/pages/?service=&spectrum={spectrum}")
        viewer.page.wait_for_selector("body[data-moving=true]")
        viewer.page.wait_for_timeout(1000)
        before = viewer.page.locator("#tree").screenshot()
        viewer.page.wait_for_timeout(1500)
        assert viewer.page.locator("#tree").screenshot() != before, "nothing moves"
    viewer.expects = ("favicon", "404")
