"""three.js with its GLTFLoader and meshoptimizer's decoder plays a compressed GLB as the plain one, in Chromium."""

import base64
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from dynamictree.spectrum import Wind
from lab.dataset.sample import make_sample, voxel_spectrum

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
DECODER = Path(__file__).parents[2] / ".cache/js-tools/node_modules/meshoptimizer/meshopt_decoder.mjs"
LARGEST_M = 1e-3

# vertices of both files, one after another, after each number of seconds
PLAY = """async ({ files, decoder, times }) => {
  const THREE = await import("three");
  const { GLTFLoader } = await import("gltf-loader");
  const module = URL.createObjectURL(new Blob([decoder], { type: "text/javascript" }));
  const { MeshoptDecoder } = await import(module);
  const played = [];
  for (const file of files) {
    const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
    const bytes = Uint8Array.from(atob(file), (c) => c.charCodeAt(0));
    const { scene, animations } = await loader.parseAsync(bytes.buffer, "");
    const mixer = new THREE.AnimationMixer(scene);
    mixer.clipAction(animations[0]).play();
    played.push(times.map((time) => {
      mixer.setTime(time);
      scene.updateMatrixWorld(true);
      const places = [];
      scene.traverse((part) => {
        if (!part.isMesh) return;
        const at = new THREE.Vector3();
        for (let v = 0; v < part.geometry.attributes.position.count; v++)
          places.push(part.getVertexPosition(v, at).applyMatrix4(part.matrixWorld).toArray());
      });
      return places;
    }));
  }
  return played;
}"""


def test_three_plays_the_compressed_files_as_the_plain_ones(browser: Browser, tmp_path: Path) -> None:
    if not DECODER.exists():
        pytest.skip("meshoptimizer is not there: make js-tools, with node and npm")
    sample = make_sample(3, "sapling", wind=Wind(speed_m_s=4.0, direction_deg=160.0, gust=0.42))
    spectrum = voxel_spectrum(sample, 32)[1]
    written = {}
    for compression in ("none", "meshopt"):
        params = ExportParams(formats=("glb", "glb-reduced", "html"), glb_compression=compression)
        folder = tmp_path / compression
        folder.mkdir()
        written[compression] = write_products(sample.mesh, spectrum, params, folder)
    page = browser.new_page(offline=True)
    page.goto(written["none"]["html"].as_uri(), timeout=120_000)  # brings three.js and its loader
    page.wait_for_function("window.player", timeout=60_000)
    for name in ("glb", "glb-reduced"):
        files = [written[compression][name].read_bytes() for compression in ("none", "meshopt")]
        assert len(files[1]) < 0.7 * len(files[0])
        given = {"files": [base64.b64encode(file).decode() for file in files], "times": [0.0, 1.3, 3.2]}
        plain, packed = np.array(page.evaluate(PLAY, given | {"decoder": DECODER.read_text()}))
        assert np.linalg.norm(plain[1] - plain[2], axis=1).max() > 0.05
        assert np.linalg.norm(packed - plain, axis=2).max() < LARGEST_M
    page.close()
