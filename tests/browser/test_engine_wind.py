"""The GLSL that the product `wind` ships moves vertices in a real browser where the reference has them."""

import io
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pygltflib
import pytest
from playwright.sync_api import Browser

from benchmarks._engine_wind import read_engine_wind
from benchmarks._played import accessor, z_up
from dynamictree.dataset.sample import make_sample, voxel_spectrum
from dynamictree.export.write import write_products
from dynamictree.requests import ExportParams
from tests.browser.shaders import COMPILER
from tests.export.test_engine_wind import with_gains

RUN = (
    """
async ([module, width, height, texels, lookup, times, speeds]) => {
  const { wind } = await import(URL.createObjectURL(new Blob([module], { type: "text/javascript" })));
"""
    + COMPILER
    + """  const program = gl.createProgram();
  const main = "in vec2 at; uniform float t, speed; out vec3 moved; void main() { moved = wind(at, t, speed); }";
  gl.attachShader(program, compile(gl.VERTEX_SHADER, "#define ROW(v) (v)\\n" + wind + main));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, "out vec4 c; void main() { c = vec4(1.0); }"));
  gl.transformFeedbackVaryings(program, ["moved"], gl.INTERLEAVED_ATTRIBS);
  gl.linkProgram(program);
  gl.useProgram(program);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  const content = new Float32Array(texels);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, content);
  for (const name of ["MIN", "MAG"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}_FILTER`], gl.NEAREST);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(lookup), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(gl.getAttribLocation(program, "at"));
  gl.vertexAttribPointer(gl.getAttribLocation(program, "at"), 2, gl.FLOAT, false, 0, 0);
  const count = lookup.length / 2;
  gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, gl.createBuffer());
  gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, count * 12, gl.STREAM_READ);
  gl.enable(gl.RASTERIZER_DISCARD);
  return times.map((seconds, number) => {
    gl.uniform1f(gl.getUniformLocation(program, "t"), seconds);
    gl.uniform1f(gl.getUniformLocation(program, "speed"), speeds[number]);
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, count);
    gl.endTransformFeedback();
    const moved = new Float32Array(3 * count);
    gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, moved);
    return Array.from(moved);
  });
}
"""
)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_shipped_shader_moves_vertices_as_the_reference_does(browser: Browser, tmp_path: Path) -> None:
    sample = make_sample(3, "sapling")
    spectrum = with_gains(voxel_spectrum(sample, 32)[1])
    path = write_products(sample.mesh, spectrum, ExportParams(formats=("wind",)), tmp_path)["wind"]
    archive = zipfile.ZipFile(io.BytesIO(path.read_bytes()))
    texels = OpenEXR.File(archive.extract("modes.exr", tmp_path)).channels()["RGB"].pixels.astype(np.float32)
    height, width, _ = texels.shape
    document = pygltflib.GLTF2().load_from_bytes(archive.read("tree-modes.glb"))
    lookup = accessor(document, document.meshes[0].primitives[0].attributes.TEXCOORD_1)
    assert spectrum.wind is not None
    times, speeds = np.array([0.0, 3.7, 120.0]), (spectrum.wind.speed_m_s, 1.0, 20.0)
    page = browser.new_page()
    colours = np.concatenate([texels, np.ones((height, width, 1), np.float32)], axis=2).ravel().tolist()
    module = archive.read("wind-three.js").decode()
    given = [module, width, height, colours, lookup.ravel().tolist(), times.tolist(), list(speeds)]
    there = page.evaluate(RUN, given)
    page.close()
    engine = read_engine_wind(archive)
    moments = zip(times.tolist(), speeds, strict=True)
    truth = np.stack([engine.displacement(seconds, speed) for seconds, speed in moments])
    gap = np.linalg.norm(z_up(np.array(there).reshape(truth.shape)) - truth, axis=2)
    assert gap.max() < 1e-3
    assert np.linalg.norm(truth, axis=2).max() > 0.02
