"""PlayCanvas reads and draws the GLB with KHR_gaussian_splatting that `dynamictree convert` writes, in Chromium."""

import base64
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser

from dynamictree.formats.gltf.gaussian import write_gltf_gaussian
from dynamictree.gaussian.harmonics import harmonics
from dynamictree.rotation import quaternion_matrices
from dynamictree.up_axis import up_rotation
from tests.formats.meshes import written
from tests.formats.test_cloud_round_trips import covariances, make_cloud

ENGINE = Path(__file__).parents[2] / ".cache/js-tools/node_modules/playcanvas/build/playcanvas.min.mjs"

LOAD = """async ({ engine, glb }) => {
  const pc = await import(URL.createObjectURL(new Blob([engine], { type: "text/javascript" })));
  const canvas = document.querySelector("canvas");
  const app = new pc.Application(canvas, { graphicsDeviceOptions: { preserveDrawingBuffer: true } });
  app.start();
  const bytes = Uint8Array.from(atob(glb), (c) => c.charCodeAt(0));
  const url = URL.createObjectURL(new Blob([bytes]));
  const asset = await new Promise((done, fail) => {
    app.assets.loadFromUrlAndFilename(url, "tree.glb", "container", (e, got) => (e ? fail(e) : done(got)));
  });
  const camera = new pc.Entity();
  camera.addComponent("camera", { clearColor: new pc.Color(0, 0, 0) });
  camera.setPosition(0, 0, 12);
  app.root.addChild(camera);
  const tree = new pc.Entity();
  tree.addComponent("gsplat", { asset: asset.resource.gsplats[0] });
  app.root.addChild(tree);
  for (let frame = 0; frame < 60; frame++) await new Promise(requestAnimationFrame);
  const { gsplatData } = asset.resource.gsplats[0].resource;
  const columns = gsplatData.elements[0].properties.map(({ name, storage }) => [name, Array.from(storage)]);
  return { columns: Object.fromEntries(columns), picture: canvas.toDataURL("image/png").split(",")[1] };
}"""


def test_playcanvas_has_every_gaussian_as_it_was_written(browser: Browser, rng: np.random.Generator) -> None:
    if not ENGINE.exists():
        pytest.skip("PlayCanvas is not there: make js-tools, with node and npm")
    cloud = make_cloud(rng, degree=3)
    cloud = replace(cloud, scales=np.maximum(cloud.scales, 0.2).astype(np.float32))
    page = browser.new_page(offline=True)
    page.set_content("<canvas width=256 height=256></canvas>")
    given = {"engine": ENGINE.read_text(), "glb": base64.b64encode(written(write_gltf_gaussian, cloud)).decode()}
    read = page.evaluate(LOAD, given)
    page.close()
    columns = {name: np.array(values) for name, values in read["columns"].items()}
    count = cloud.num_gaussians
    rows = np.argsort(columns["x"]), np.argsort(cloud.means[:, 0])

    def table(name: str, width: int) -> np.ndarray:
        return np.stack([columns[f"{name}_{number}"] for number in range(width)], axis=1)

    turn = up_rotation("+Y").T  # rotation from our axes to glTF's
    places = np.stack([columns[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(places[rows[0]], (cloud.means @ turn.T)[rows[1]], atol=1e-5)
    np.testing.assert_allclose(columns["opacity"][rows[0]], cloud.opacity[rows[1]], atol=1e-6)
    rotations = quaternion_matrices(table("rot", 4))
    spread = rotations * table("scale", 3)[:, None, :] ** 2 @ rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(spread[rows[0]], (turn @ covariances(cloud) @ turn.T)[rows[1]], atol=1e-5)
    rest = table("f_rest", 45).reshape(count, 3, 15).swapaxes(1, 2)
    sh = np.concatenate([table("f_dc", 3)[:, None], rest], axis=1)
    seen = rng.normal(size=(20, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    colours = np.einsum("vh,ghc->gvc", harmonics(seen @ turn.T, 3), sh)
    np.testing.assert_allclose(
        colours[rows[0]], np.einsum("vh,ghc->gvc", harmonics(seen, 3), cloud.sh)[rows[1]], atol=1e-4
    )
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(read["picture"]))).convert("RGB"))
    assert (picture.max(axis=2) > 40).mean() > 0.05
