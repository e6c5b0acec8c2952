"""The product `wind` moves vertices in three.js, in a real browser, where the reference has them."""

import io
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pygltflib
from playwright.sync_api import Browser

from benchmarks._engine_wind import read_engine_wind
from benchmarks._read_exports import accessor, z_up
from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.export.test_engine_wind import with_gains

RUN = """
async ([module, width, height, texels, places, lookup, runs]) => {
  const THREE = await import("three");
  const { treeWind } = await import(URL.createObjectURL(new Blob([module], { type: "text/javascript" })));
  const bones = new THREE.DataTexture(new Float32Array(texels), width, height, THREE.RGBAFormat, THREE.FloatType);
  const tree = treeWind(bones, "first");
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(places), 3));
  geometry.setAttribute("uv1", new THREE.BufferAttribute(new Float32Array(lookup), 2));
  const material = tree.windy(new THREE.PointsMaterial());
  const shipped = material.onBeforeCompile;
  const rows = Math.ceil(places.length / 3 / 64);
  material.onBeforeCompile = (shader) => { // one pixel a vertex
    shipped(shader);
    shader.vertexShader = shader.vertexShader
      .replace("void main() {", "varying vec3 moved;\\nvoid main() {")
      .replace(/}\\s*$/, `moved = transformed - position;
        gl_PointSize = 1.0;
        vec2 pixel = vec2(float(gl_VertexID % 64), float(gl_VertexID / 64)) + 0.5;
        gl_Position = vec4(pixel / vec2(64.0, ${rows}.0) * 2.0 - 1.0, 0.0, 1.0);
      }`);
    shader.fragmentShader = shader.fragmentShader
      .replace("void main() {", "varying vec3 moved;\\nvoid main() {")
      .replace(/}\\s*$/, "gl_FragColor = vec4(moved, 1.0);\\n}");
  };
  const points = new THREE.Points(geometry, material);
  points.frustumCulled = false;
  const renderer = new THREE.WebGLRenderer();
  const target = new THREE.WebGLRenderTarget(64, rows, { type: THREE.FloatType });
  return runs.map(([seconds, speed]) => {
    tree.move(renderer, seconds, speed);
    renderer.setRenderTarget(target);
    renderer.render(points, new THREE.Camera());
    const moved = new Float32Array(4 * 64 * rows);
    renderer.readRenderTargetPixels(target, 0, 0, 64, rows, moved);
    return Array.from(moved);
  });
}
"""


def test_three_moves_vertices_as_the_reference_does(browser: Browser, tmp_path: Path) -> None:
    sample = make_sample(3, "sapling")
    spectrum = with_gains(voxel_spectrum(sample, 32)[1])
    paths = write_products(sample.mesh, spectrum, ExportParams(formats=("wind", "html")), tmp_path)
    archive = zipfile.ZipFile(io.BytesIO(paths["wind"].read_bytes()))
    texels = OpenEXR.File(archive.extract("bones.exr", tmp_path)).channels()["RGB"].pixels.astype(np.float32)
    height, width, _ = texels.shape
    document = pygltflib.GLTF2().load_from_bytes(archive.read("tree-bones.glb"))
    attributes = document.meshes[0].primitives[0].attributes
    places, lookup = accessor(document, attributes.POSITION), accessor(document, attributes.TEXCOORD_1)
    assert spectrum.wind is not None
    runs = [(0.0, spectrum.wind.speed_m_s), (3.7, 1.0), (120.0, 16.0)]
    page = browser.new_page(offline=True)
    page.goto(paths["html"].as_uri(), timeout=120_000)  # brings three.js
    colours = np.concatenate([texels, np.ones((height, width, 1), np.float32)], axis=2).ravel().tolist()
    module = archive.read("wind-three.js").decode()
    given = [module, width, height, colours, places.ravel().tolist(), lookup.ravel().tolist(), runs]
    there = np.array(page.evaluate(RUN, given)).reshape(len(runs), -1, 4)[:, : len(places), :3]
    page.close()
    engine = read_engine_wind(archive)
    truth = np.stack([engine.displacement(seconds, speed) for seconds, speed in runs])
    gap = np.linalg.norm(z_up(there) - truth, axis=2)
    assert gap.max() < 1e-3
    assert np.linalg.norm(truth, axis=2).max() > 0.02
