"""three.js plays a GLB with meshopt's compression or WebP textures as the plain one, in Chromium."""

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser

from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from dynamictree.spectrum import Wind
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.formats.test_webp_textures import PICTURES, pixels, tree_of, written

DECODER = Path(__file__).parents[2] / ".cache/js-tools/node_modules/meshoptimizer/meshopt_decoder.mjs"

# of each file its vertices, one after another, after each number of seconds, and the textures of its last part
PLAY = """async ({ files, decoder, times }) => {
  const THREE = await import("three");
  const { GLTFLoader } = await import("gltf-loader");
  const module = URL.createObjectURL(new Blob([decoder], { type: "text/javascript" }));
  const { MeshoptDecoder } = await import(module);
  const played = [];
  for (const file of files) {
    const bytes = Uint8Array.from(atob(file), (c) => c.charCodeAt(0));
    const { scene, animations } = await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).parseAsync(bytes.buffer, "");
    const mixer = new THREE.AnimationMixer(scene);
    mixer.clipAction(animations[0]).play();
    let material;
    const places = times.map((time) => {
      mixer.setTime(time);
      scene.updateMatrixWorld(true);
      const now = [];
      scene.traverse((part) => {
        if (!part.isMesh) return;
        ({ material } = part);
        const at = new THREE.Vector3();
        for (let v = 0; v < part.geometry.attributes.position.count; v++)
          now.push(part.getVertexPosition(v, at).applyMatrix4(part.matrixWorld).toArray());
      });
      return now;
    });
    const image = material.map?.image ?? new OffscreenCanvas(1, 1);
    const canvas = new OffscreenCanvas(image.width, image.height);
    canvas.getContext("2d").drawImage(image, 0, 0);
    const { data } = canvas.getContext("2d").getImageData(0, 0, image.width, image.height);
    played.push({ places, width: image.width, rgba: Array.from(data), normals: material.normalMap?.image.width });
  }
  return played;
}"""


def played(browser: Browser, html: Path, files: list[Path], times: list[float]) -> list[dict[str, Any]]:
    """By the three.js and its loader that a page has."""
    if not DECODER.exists():
        pytest.skip("meshoptimizer is not there: make js-tools, with node and npm")
    page = browser.new_page(offline=True)
    page.goto(html.as_uri(), timeout=120_000)
    page.wait_for_function("window.player", timeout=60_000)
    given = {"files": [base64.b64encode(file.read_bytes()).decode() for file in files], "times": times}
    seen: list[dict[str, Any]] = page.evaluate(PLAY, given | {"decoder": DECODER.read_text()})
    page.close()
    return seen


def test_three_plays_the_compressed_file_as_the_plain_one(browser: Browser, tmp_path: Path) -> None:
    sample = make_sample(3, "sapling", wind=Wind(speed_m_s=4.0, direction_deg=160.0, gust=0.42))
    spectrum = voxel_spectrum(sample, 32)[1]
    written = {}
    for compression in ("none", "meshopt"):
        params = ExportParams(formats=("glb", "html"), glb_compression=compression)
        folder = tmp_path / compression
        folder.mkdir()
        written[compression] = write_products(sample.mesh, spectrum, params, folder)
    files = [written[compression]["glb"] for compression in ("none", "meshopt")]
    assert files[1].stat().st_size < 0.7 * files[0].stat().st_size
    seen = played(browser, written["none"]["html"], files, [0.0, 1.3, 3.2])
    plain, packed = (np.array(file["places"]) for file in seen)
    assert np.linalg.norm(plain[1] - plain[2], axis=1).max() > 0.05
    assert np.linalg.norm(packed - plain, axis=2).max() < 1e-3


def test_three_shows_webp_textures(browser: Browser, tmp_path: Path) -> None:
    contents = {
        name: written(tree_of(PICTURES), tmp_path, "glb", "html", glb_textures=name) for name in ("source", "webp")
    }
    files = [tmp_path / f"{name}.glb" for name in contents]
    for file, content in zip(files, contents.values(), strict=True):
        file.write_bytes(content["glb"])
    plain, packed = played(browser, tmp_path / "tree.html", files, [0.05])
    assert (packed["width"], packed["normals"]) == (128, 128)
    np.testing.assert_allclose(packed["places"], plain["places"], atol=1e-6)
    canvas_rgba = np.array(packed["rgba"]).reshape(128, 128, 4)
    picture = pixels(PICTURES["baseColorTexture"], "RGBA")
    opaque = picture[..., 3] == 255
    np.testing.assert_array_equal(canvas_rgba[..., 3], picture[..., 3])
    assert np.abs(canvas_rgba - picture)[opaque].mean() < 6
