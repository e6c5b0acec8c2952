// A cloud of Gaussians that hangs on a mesh, drawn by Spark: the rules of docs/formats-splat.md in Spark's own shader.

import * as THREE from "three";
import { flutterOf } from "../motion/flutter.js";
import { halfTurn } from "../motion/swing.js";
import { readTensors } from "../motion/tensors.js";
import { rowOf } from "../motion/vectors.js";
import { floats, texture, WIDTH } from "./field.js";
import { halvesOf, modifier } from "./splat_shader.js";

const SAME_PLACE = 1e-6; // of the tree's size: a camera that has moved less stands still

/** The body of a `.animated-splat.safetensors`; its harmonics stay the half floats that a texture takes. */
export function readSplat(buffer) {
  const { tensors, shape, metadata } = readTensors(buffer, { halves: ["sh"] });
  return {
    .../** @type {any} */ (tensors),
    G: shape.means[0],
    K: shape.coefficients[1],
    harmonics: shape.sh[1],
    frames: Number(metadata.num_frames),
    fps: Number(metadata.fps),
    wind: JSON.parse(metadata.wind ?? "null"),
  };
}

/** Whether all Gaussians have one colour, as of a scan without colours: a shaded mesh shows more than they do. */
export function isUncoloured({ sh, G, harmonics }) {
  for (let g = 1; g < G; g++) {
    for (let c = 0; c < 3; c++) if (sh[3 * harmonics * g + c] !== sh[c]) return false;
  }
  return harmonics === 1;
}

/** Spark's renderer of a stage, one for all splats; sorting takes longer than a frame, and draws anew when it ends. */
export function sparkRenderer(spark, stage) {
  const onDirty = () => {
    stage.stale = true;
  };
  stage.sparkRenderer ??= new spark.SparkRenderer({ renderer: stage.renderer, accumExtSplats: true, onDirty });
  return stage.sparkRenderer;
}

export class SplatView {
  /** Gaussians that hang on a tree's `surface`, whose `uniforms` say how it moves. */
  static async make(stage, splat, surface, uniforms) {
    const spark = await import("@sparkjsdev/spark");
    const view = new SplatView();
    Object.assign(view, { stage, splat, uniforms });
    view.box = new THREE.Box3().setFromArray(splat.means);
    view.harmonics = harmonicsThatFit(splat, stage.renderer.capabilities.maxTextureSize);
    view.textures = texturesOf(splat, surface, view.harmonics);
    const cloud = new spark.ExtSplats({ maxSplats: splat.G }); // places in single precision: half would be 8 mm at 10 m
    const [at, scales] = [new THREE.Vector3(), new THREE.Vector3()];
    const turn = new THREE.Quaternion();
    const grey = new THREE.Color(0.5, 0.5, 0.5);
    for (let g = 0; g < splat.G; g++) {
      const [w, x, y, z] = splat.quaternions.subarray(4 * g, 4 * g + 4);
      at.fromArray(splat.means, 3 * g);
      scales.fromArray(splat.scales, 3 * g);
      cloud.pushSplat(at, scales, turn.set(x, y, z, w).normalize(), splat.opacity[g], grey);
    }
    cloud.updateTextures();
    view.renderer = sparkRenderer(spark, stage);
    stage.scene.add(view.renderer);
    view.values = view._values(spark.dyno);
    view.mesh = new spark.SplatMesh({
      extSplats: cloud,
      objectModifier: modifier(spark.dyno, view.values, view.harmonics),
    });
    stage.scene.add(view.mesh);
    await view.mesh.initialized;
    return view;
  }

  _values({ dynoSampler2D, dynoFloat, dynoVec3 }) {
    return {
      moved: dynoSampler2D(this.uniforms.moved.value),
      poses: dynoSampler2D(this.uniforms.poses.value),
      bent: dynoFloat(0),
      eye: dynoVec3(new THREE.Vector3()),
      ...Object.fromEntries(Object.entries(this.textures).map(([name, texels]) => [name, dynoSampler2D(texels)])),
    };
  }

  /** Whether there is something to see: the first sorting has ended, and it was not still that of another splat. */
  get drawn() {
    const { activeSplats, display } = this.renderer;
    return activeSplats > 0 && display.mapping.some(({ node }) => node === this.mesh);
  }
  get visible() {
    return this.mesh.visible;
  }
  set visible(value) {
    this.mesh.visible = value;
  }

  /** Before each draw. What has not changed is not sorted anew, so that a still picture comes to rest. */
  evaluate(q, turn, air) {
    if (!this.drawn) this.renderer.activeSplats = 0; // else another's is drawn until this one is sorted
    const { position } = this.stage.camera;
    const now = [turn, ...q, this._flutter(air)].join();
    // the controls compute the camera's place anew in each frame, which moves it in its last digits
    const stays = this.values.eye.value.distanceTo(position) < SAME_PLACE * this.stage.radius;
    if (now === this.before && stays && !this.uniforms.bent.value && !this.values.bent.value) return;
    this.before = now;
    this.values.eye.value.copy(position);
    this.values.bent.value = this.uniforms.bent.value;
    for (const name of ["moved", "poses"]) this.values[name].value = this.uniforms[name].value;
    this.mesh.updateVersion();
  }

  /** Turn the leaves; returns the phase where the air moves them. */
  _flutter(air) {
    const { leaves } = this.textures;
    const count = air ? (this.splat.leaf_vertex?.length ?? 0) : 0;
    for (let l = 0; l < count; l++) leaves.image.data.set(halfTurn(flutterOf(this.splat, l, air)), 4 * l);
    leaves.needsUpdate = count > 0; // a texture is sent again only then
    return count && air.speeds.some(Boolean) ? air.phase : 0;
  }

  dispose() {
    this.stage.scene.remove(this.mesh, this.renderer);
    this.renderer.activeSplats = 0;
    this.mesh.dispose();
    for (const texture of Object.values(this.textures)) texture.dispose();
  }
}

/** As many degrees as one texture holds: all four up to some millions of Gaussians. */
function harmonicsThatFit({ G, harmonics }, largest) {
  const fits = (count) => Math.ceil((G * halvesOf(count)) / 4 / WIDTH) <= largest;
  return [16, 9, 4].find((count) => count <= harmonics && fits(count)) ?? 1;
}

function harmonicsTexture({ G, harmonics, sh }, count) {
  const width = halvesOf(count);
  const padded = new Uint16Array(4 * WIDTH * Math.ceil((G * width) / 4 / WIDTH));
  for (let g = 0; g < G; g++) padded.set(sh.subarray(3 * g * harmonics, 3 * (g * harmonics + count)), g * width);
  return texture(padded, THREE.HalfFloatType);
}

function texturesOf(splat, surface, harmonics) {
  const { G, face_of, leaf_of = new Int32Array(splat.G).fill(-1), leaf_vertex = [], triangles, weights } = splat;
  const rows = rowsOnSurface(splat, surface);
  const corners = floats(8 * G);
  const leaves = floats(4 * leaf_vertex.length);
  for (const [l, v] of leaf_vertex.entries()) leaves[4 * l + 3] = rows[v];
  for (let g = 0; g < G; g++) {
    const face = face_of[g];
    if (face < 0) continue; // stays still: its fourth number is 0
    corners.set([...rowOf(triangles, face).map((v) => rows[v]), 1, ...rowOf(weights, g), 1 + leaf_of[g]], 8 * g);
  }
  const rest = floats(4 * surface.N);
  const joints = floats(4 * surface.N);
  for (let v = 0; v < surface.N; v++) {
    rest.set(rowOf(surface.vertices, v), 4 * v);
    joints.set(rowOf(surface.joints, v), 4 * v);
  }
  const sh = harmonicsTexture(splat, harmonics);
  return { corners: texture(corners), rest: texture(rest), joints: texture(joints), leaves: texture(leaves), sh };
}

/** The surface's vertex in the place of each of the splat's, which are of the same mesh. */
function rowsOnSurface({ vertices }, surface) {
  const key = (places, v) => rowOf(places, v).join();
  const at = new Map(Array.from({ length: surface.N }, (_, v) => [key(surface.vertices, v), v]));
  return Array.from({ length: vertices.length / 3 }, (_, v) => at.get(key(vertices, v)));
}
