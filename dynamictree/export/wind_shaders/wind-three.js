// three.js: const tree = treeWind(bones), bones.exr by EXRLoader; tree.windy(material) for each material of tree-bones.glb;
// before each frame tree.move(renderer, seconds, speed): time plus an offset per tree, mean speed of the wind in m/s.
import * as THREE from "three";

const POSES = `
precision highp sampler2D;
CONSTANTS
uniform sampler2D bones;
uniform float seconds, speed;
varying vec2 texel;
#define BONE(at, part) textureLod(bones, vec2((at).x, ROW(((at).y + float(part)) / NUM_PARTS)), 0.0).xyz
CORE
void main() { gl_FragColor = vec4(pose(texel, seconds, speed), 1.0); }`;
const SKIN = `
precision highp sampler2D;
LAYOUT
uniform sampler2D poses;
#define POSE(at, part) textureLod(poses, vec2((at).x, ((at).y + float(part)) / 4.0), 0.0).xyz
SURFACE`;

/** The wind of one tree; `rows` says whether row 0 of the texture is its first or its last. */
export function treeWind(bones, rows = "last") {
  const nearest = { minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter, generateMipmaps: false };
  Object.assign(bones, nearest, { needsUpdate: true });
  const poses = new THREE.WebGLRenderTarget(POSES_WIDTH, POSES_HEIGHT, { ...nearest, type: THREE.FloatType, depthBuffer: false });
  const uniforms = { bones: { value: bones }, seconds: { value: 0 }, speed: { value: OWN_M_S } };
  const material = new THREE.ShaderMaterial({
    uniforms,
    vertexShader: "varying vec2 texel; void main() { texel = 0.5 + 0.5 * position.xy; gl_Position = vec4(position.xy, 0, 1); }",
    fragmentShader: `#define ROW(v) ${rows === "last" ? "(1.0 - (v))" : "(v)"}\n${POSES}`,
    depthTest: false,
  });
  const square = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
  square.frustumCulled = false;
  const camera = new THREE.Camera();
  return {
    move(renderer, seconds, speed = OWN_M_S) {
      [uniforms.seconds.value, uniforms.speed.value] = [seconds, speed];
      const before = renderer.getRenderTarget();
      renderer.setRenderTarget(poses);
      renderer.render(square, camera);
      renderer.setRenderTarget(before);
    },
    windy(material) {
      material.onBeforeCompile = (shader) => {
        shader.uniforms.poses = { value: poses.texture };
        const lookup = "#ifndef USE_UV1\nattribute vec2 uv1;\n#endif\n";
        shader.vertexShader = `${lookup}${SKIN}\n${shader.vertexShader}`.replace(
          "#include <begin_vertex>",
          "#include <begin_vertex>\ntransformed += wind(uv1, position);",
        );
      };
      return material;
    },
  };
}
