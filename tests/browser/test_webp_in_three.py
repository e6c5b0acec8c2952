"""three.js shows the WebP textures of a GLB and plays its motion as without them, in Chromium."""

import base64
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from tests.formats.test_webp_textures import PICTURES, pixels, tree_of, written

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SHOW = """async (files) => {
  const THREE = await import("three");
  const { GLTFLoader } = await import("gltf-loader");
  const seen = [];
  for (const file of files) {
    const bytes = Uint8Array.from(atob(file), (c) => c.charCodeAt(0));
    const { scene, animations } = await new GLTFLoader().parseAsync(bytes.buffer, "");
    const mixer = new THREE.AnimationMixer(scene);
    mixer.clipAction(animations[0]).play();
    mixer.setTime(0.05);
    scene.updateMatrixWorld(true);
    let tree;
    scene.traverse((part) => { if (part.isMesh) tree = part; });
    const at = new THREE.Vector3();
    const places = [];
    for (let v = 0; v < tree.geometry.attributes.position.count; v++)
      places.push(tree.getVertexPosition(v, at).toArray());
    const { image } = tree.material.map;
    const canvas = new OffscreenCanvas(image.width, image.height);
    canvas.getContext("2d").drawImage(image, 0, 0);
    const { data } = canvas.getContext("2d").getImageData(0, 0, image.width, image.height);
    seen.push({ places, width: image.width, rgba: Array.from(data), normals: tree.material.normalMap.image.width });
  }
  return seen;
}"""


def test_three_shows_webp_textures(browser: Browser, tmp_path: Path) -> None:
    files = [written(tree_of(PICTURES), tmp_path, "glb", "html", glb_textures=name) for name in ("source", "webp")]
    page = browser.new_page(offline=True)
    page.goto((tmp_path / "tree.html").as_uri(), timeout=120_000)  # brings three.js and its loader
    page.wait_for_function("window.player", timeout=60_000)
    plain, packed = page.evaluate(SHOW, [base64.b64encode(file["glb"]).decode() for file in files])
    page.close()
    assert (packed["width"], packed["normals"]) == (128, 128)
    np.testing.assert_allclose(packed["places"], plain["places"], atol=1e-6)
    canvas_rgba = np.array(packed["rgba"]).reshape(128, 128, 4)
    picture = pixels(PICTURES["baseColorTexture"], "RGBA")
    opaque = picture[..., 3] == 255
    np.testing.assert_array_equal(canvas_rgba[..., 3], picture[..., 3])
    assert np.abs(canvas_rgba - picture)[opaque].mean() < 6
