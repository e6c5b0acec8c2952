"""The shader of docs/engines.md gives the reference's coordinates, in a real browser."""

import re
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser

from dynamictree.modal.turbulence import Wave, turbulent_wind
from tests.browser.shaders import COMPILER
from tests.modal.conftest import rod_spectrum

DOCS = Path(__file__).parents[2] / "docs" / "engines.md"
RUN = (
    """
([source, partial, gust, bound, times]) => {
"""
    + COMPILER
    + """  const program = gl.createProgram();
  const main = source + "uniform float t; out vec2 q; void main() { q = coordinate(gl_VertexID + 1, t); }";
  gl.attachShader(program, compile(gl.VERTEX_SHADER, main));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, "out vec4 c; void main() { c = vec4(1.0); }"));
  gl.transformFeedbackVaryings(program, ["q"], gl.INTERLEAVED_ATTRIBS);
  gl.linkProgram(program);
  gl.useProgram(program);
  gl.uniform2fv(gl.getUniformLocation(program, "partial"), partial);
  gl.uniform3fv(gl.getUniformLocation(program, "gustOf"), gust);
  gl.uniform2fv(gl.getUniformLocation(program, "boundOf"), bound);
  gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, gl.createBuffer());
  gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, 15 * 8, gl.STREAM_READ);
  gl.enable(gl.RASTERIZER_DISCARD);
  return times.map((t) => {
    gl.uniform1f(gl.getUniformLocation(program, "t"), t);
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, 15);
    gl.endTransformFeedback();
    const q = new Float32Array(30);
    gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, q);
    return Array.from(q);
  });
}
"""
)


def test_the_shader_gives_the_references_coordinates(browser: Browser) -> None:
    source = re.findall(r"```glsl\n(uniform vec2 partial.*?)```", DOCS.read_text(), re.DOTALL)[0]
    wind = turbulent_wind(rod_spectrum(), seed=2)
    times = np.array([0.0, 1.3, 61.7, 500.0])
    partial = np.stack([wind.partial_hz[1:], wind.partial_phase_rad[1:]], axis=-1).ravel().tolist()
    page = browser.new_page()
    there = page.evaluate(RUN, [source, partial, *uniforms(wind.strength), times.tolist()])
    q = wind.coordinates(times)[:, 1:]
    np.testing.assert_allclose(there, np.stack([q.real, q.imag], axis=-1).reshape(len(times), 30), atol=5e-3)
    page.close()


def uniforms(wave: Wave) -> list[list[float]]:
    columns = np.stack([wave.frequency_hz, wave.amplitude, wave.phase_rad], axis=1)
    return [columns.ravel().tolist(), [wave.mean, wave.limit]]
