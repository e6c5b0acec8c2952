"""JavaScript that the tests of shaders begin with."""

COMPILER = """
  const gl = document.createElement("canvas").getContext("webgl2");
  const compile = (type, text) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, "#version 300 es\\nprecision highp float;\\n" + text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
"""
