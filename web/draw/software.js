// Whether WebGL runs on the processor, where each sample of a pixel costs time.

const NAMES = /swiftshader|llvmpipe|softpipe|software|basic render/i;

export function drawsInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return NAMES.test(name);
}
