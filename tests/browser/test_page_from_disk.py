"""`tree.html` plays in a real Chromium from disk, without a server, where the spectrum has its vertices."""

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from benchmarks._played import z_up
from dynamictree import method
from dynamictree.dataset.sample import make_sample, voxel_spectrum
from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from dynamictree.spectrum import iter_motion

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

PLACES = """(time) => {
  const places = [];
  player.renderer.setAnimationLoop(null);
  player.mixer.setTime(time);
  player.tree.traverse((part) => {
    if (part.isMesh && !places.length) {
      for (let i = 0; i < part.geometry.attributes.position.count; i++) {
        places.push(part.getVertexPosition(i, part.position.clone()).toArray());
      }
    }
  });
  return places;
}"""


def test_the_page_plays_the_motion_from_disk(browser: Browser, tmp_path: Path) -> None:
    sample = make_sample(3, "sapling")
    spectrum = voxel_spectrum(sample, 32)[1]
    path = write_products(sample.mesh, spectrum, ExportParams(formats=("html",)), tmp_path)["html"]
    page = browser.new_page(viewport={"width": 320, "height": 320}, offline=True)
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.goto(path.as_uri())
    page.wait_for_function("window.player", timeout=60_000)
    truth = list(iter_motion(method.devoxelize(spectrum, sample.mesh), np.arange(100) / 100))
    for frame in (0, 31, 77):
        moved = z_up(np.array(page.evaluate(PLACES, frame / 24))) - sample.mesh.vertices
        assert np.abs(moved - truth[frame]).max() < 1e-4
    assert not problems
    page.close()
