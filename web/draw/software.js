// The canvas's WebGL context: with multisampling on a graphics card, without it where WebGL runs on the processor.

const NAMES = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const ATTRIBUTES = { alpha: true, stencil: true, powerPreference: "high-performance" };

/**
 * `{ canvas, context, soft }`. A canvas keeps its first context, which alone says where it runs; in software that is
 * the right one, since there each takes a tenth of a second. On a card another canvas takes the place of `first`.
 */
export function contextOf(first) {
  const context = first.getContext("webgl2", { ...ATTRIBUTES, antialias: false });
  if (!context || runsInSoftware(context)) return { canvas: first, context, soft: true };
  context.getExtension("WEBGL_lose_context")?.loseContext();
  const canvas = first.cloneNode();
  first.replaceWith(canvas);
  return { canvas, context: canvas.getContext("webgl2", { ...ATTRIBUTES, antialias: true }), soft: false };
}

function runsInSoftware(gl) {
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return NAMES.test(names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "");
}
