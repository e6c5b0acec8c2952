// three.js: material = windy(material, modes) for each material of tree-modes.glb, modes.exr by EXRLoader
// (NearestFilter, flipY as loaded), then every frame material.userData.seconds.value = time + offset of this tree.
export const wind = `
precision highp sampler2D;
CONSTANTS
uniform sampler2D modes;
#define MODE(part) textureLod(modes, vec2(lookup.x, ROW(lookup.y + float(part) * PART_STEP)), 0.0).xyz
CORE`;

/** Let the wind move a material's vertices; `rows` says whether row 0 of the texture is its first or its last. */
export function windy(material, modes, rows = "last") {
  const seconds = { value: 0 };
  material.userData.seconds = seconds;
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, { modes: { value: modes }, seconds });
    const row = rows === "last" ? "#define ROW(v) (1.0 - (v))" : "#define ROW(v) (v)";
    const lookup = "#ifndef USE_UV1\nattribute vec2 uv1;\n#endif\nuniform float seconds;";
    shader.vertexShader = `${row}\n${lookup}\n${wind}\n${shader.vertexShader}`.replace(
      "#include <begin_vertex>",
      "#include <begin_vertex>\ntransformed += wind(uv1, seconds);",
    );
  };
  return material;
}
