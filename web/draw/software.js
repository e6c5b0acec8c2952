// Whether WebGL runs on the processor, where each sample of a pixel costs time.

const NAMES = /swiftshader|llvmpipe|softpipe|software|basic render/i;

let known = null;

/** Asked once: the first context of a page takes a tenth of a second, in which files can be loaded. */
export const drawsInSoftware = () => (known ??= asksItsName());

function asksItsName() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return NAMES.test(name);
}
