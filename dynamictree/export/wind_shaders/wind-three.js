// three.js: material = windy(material, modes) for each material of tree-modes.glb, modes.exr by EXRLoader (NearestFilter,
// flipY as loaded); every frame set material.userData.seconds.value (time + offset of this tree) and speed.value [m/s].
export const wind = `
precision highp sampler2D;
CONSTANTS
uniform sampler2D modes;
#define MODE(part) textureLod(modes, vec2(lookup.x, ROW(lookup.y + float(part) * PART_STEP)), 0.0).xyz
CORE`;

/** Let the wind move a material's vertices; `rows` says whether row 0 of the texture is its first or its last. */
export function windy(material, modes, rows = "last") {
  const [seconds, speed] = [{ value: 0 }, { value: OWN_M_S }];
  Object.assign(material.userData, { seconds, speed });
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, { modes: { value: modes }, seconds, speed });
    const row = rows === "last" ? "#define ROW(v) (1.0 - (v))" : "#define ROW(v) (v)";
    const lookup = "#ifndef USE_UV1\nattribute vec2 uv1;\n#endif\nuniform float seconds, speed;";
    shader.vertexShader = `${row}\n${lookup}\n${wind}\n${shader.vertexShader}`.replace(
      "#include <begin_vertex>",
      "#include <begin_vertex>\ntransformed += wind(uv1, seconds, speed);",
    );
  };
  return material;
}
