// The canvas's WebGL context: with multisampling on a graphics card, without it where WebGL runs on the processor, for which
// shaders do less there.

import * as THREE from "three";

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

const CHUNKS = { ...THREE.ShaderChunk };

/** Let three.js' shaders, from now on, take less time in software. */
export function lightenShaders() {
  // one lookup of a shadow between texels, in a loop: software skips one beside the map, as it does not skip a branch
  const once = "for (int i = int(frustumTest); i > 0; i--) shadow = texture(shadowMap, shadowCoord.xyz);";
  lighten("shadowmap_pars_fragment", /if \( frustumTest \) \{[^}]*vogel[^}]*\}/, once);
  // the screen's colours by three roots in place of a power; above 0.002 they are off by 0.3 of 255 at most
  const roots = `vec3 a = sqrt(value.rgb), b = sqrt(a), c = sqrt(b);
return vec4(0.662002687 * a + 0.68412206 * b - 0.323583601 * c - 0.022541147 * value.rgb, value.a); `;
  lighten("colorspace_pars_fragment", /(vec4 sRGBTransferOETF\([^{]*\{)[^}]*/, `$1 ${roots}`);
}

function lighten(name, heavy, light) {
  if (!heavy.test(CHUNKS[name])) throw new Error(`three.js has another ${name} now`);
  THREE.ShaderChunk[name] = CHUNKS[name].replace(heavy, light);
}
