// A cloud of Gaussians that hangs on a mesh, drawn by Spark: the rules of docs/formats-splat.md in Spark's own shader.

import * as THREE from "three";
import { modeSum } from "../motion/modes.js";
import { readTensors } from "../motion/tensors.js";
import { turnedUpright } from "../motion/vectors.js";
import { Field, placesTexture } from "./field.js";
import { halvesOf, modifier, WIDTH } from "./splat_shader.js";

const SAME_PLACE = 1e-6; // of the tree's size: a camera that has moved less stands still

/** The body of a `.animated-splat.safetensors`; its harmonics stay the half floats that a texture takes. */
export function readSplat(buffer) {
  const { tensors, shape, metadata } = readTensors(buffer, { halves: ["sh"] });
  return {
    .../** @type {any} */ (tensors),
    G: shape.means[0],
    N: shape.vertices[0],
    K: shape.coefficients[1],
    harmonics: shape.sh[1],
    frames: Number(metadata.num_frames),
    fps: Number(metadata.fps),
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
  /** `ride` is that of draw/ride.js or `ownRide`; `poses` and `bent` are the tree's uniforms. */
  static async make(stage, splat, ride, uniforms) {
    const spark = await import("@sparkjsdev/spark");
    const view = new SplatView();
    view.stage = stage;
    Object.assign(view, { ride, field: ride.field, uniforms });
    view.box = new THREE.Box3().setFromArray(splat.means);
    view.harmonics = harmonicsThatFit(splat, stage.renderer.capabilities.maxTextureSize);
    view.textures = texturesOf(splat, ride, view.harmonics);
    const cloud = new spark.ExtSplats({ maxSplats: splat.G }); // places in single precision: half would be 8 mm at 10 m
    const [at, scales, turn, grey] = [
      new THREE.Vector3(),
      new THREE.Vector3(),
      new THREE.Quaternion(),
      new THREE.Color(0.5, 0.5, 0.5),
    ];
    for (let g = 0; g < splat.G; g++) {
      at.fromArray(splat.means, 3 * g);
      scales.fromArray(splat.scales, 3 * g);
      turn
        .set(
          splat.quaternions[4 * g + 1],
          splat.quaternions[4 * g + 2],
          splat.quaternions[4 * g + 3],
          splat.quaternions[4 * g],
        )
        .normalize();
      cloud.pushSplat(at, scales, turn, splat.opacity[g], grey);
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
      moved: dynoSampler2D(this.field.texture),
      poses: dynoSampler2D(this.uniforms.poses.value),
      bent: dynoFloat(0),
      corners: dynoSampler2D(this.textures.corners),
      rest: dynoSampler2D(this.textures.rest),
      bones: dynoSampler2D(this.textures.bones),
      sh: dynoSampler2D(this.textures.sh),
      eye: dynoVec3(new THREE.Vector3()),
    };
  }

  /** Whether there is something to see: the first sorting has ended. */
  get drawn() {
    return this.renderer.activeSplats > 0;
  }
  get visible() {
    return this.mesh.visible;
  }
  set visible(value) {
    this.mesh.visible = value;
  }

  /** Before each draw. What has not changed is not sorted anew, so that a still picture comes to rest. */
  evaluate(renderer, q, turn) {
    const { camera, radius } = this.stage;
    const { position } = camera;
    const now = [turn, ...q].join();
    // the controls compute the camera's place anew in each frame, which moves it in its last digits
    const stays = this.values.eye.value.distanceTo(position) < SAME_PLACE * radius;
    if (now === this.before && stays && !this.uniforms.bent.value && !this.values.bent.value) return;
    this.before = now;
    if (!this.ride.borrowed) this.field.evaluate(renderer, q, turn);
    this.values.eye.value.copy(position);
    this.values.bent.value = this.uniforms.bent.value;
    this.values.poses.value = this.uniforms.poses.value;
    this.mesh.updateVersion();
  }

  dispose() {
    this.stage.scene.remove(this.mesh, this.renderer);
    this.renderer.activeSplats = 0;
    this.mesh.dispose();
    if (!this.ride.borrowed) this.field.dispose();
    for (const texture of Object.values(this.textures)) texture.dispose();
  }
}

/** How Gaussians ride on the faces of a mesh that moves as their file says; `carriers`: four bones and weights a vertex. */
export function ownRide(splat, carriers) {
  const { means, face_of, triangles, weights, vertices, N } = splat;
  const { shapes, scale_m } = stepsOf(splat);
  const inWind = (row, q, turn) => turnedUpright(modeSum(shapes, scale_m, row, q), turn);
  const field = new Field(shapes, scale_m, N, 1, { places: placesTexture(vertices) });
  return { means, face_of, triangles, weights, vertices, carriers, field, inWind };
}

/** Float16 coefficients as 16-bit steps a bin, weighted as the spectrum's sum wants them. */
function stepsOf({ coefficients, K, frames }) {
  const scale = new Float32Array(K);
  const shapes = new Int16Array(coefficients.length);
  const bin = (i) => Math.floor(i / 6) % K;
  coefficients.forEach((value, i) => {
    scale[bin(i)] = Math.max(scale[bin(i)], Math.abs(value));
  });
  coefficients.forEach((value, i) => {
    shapes[i] = Math.round((32767 * value) / Math.max(scale[bin(i)], 1e-12));
  });
  const weighted = scale.map((most, k) => (Math.max(most, 1e-12) / 32767) * (k === 0 || 2 * k === frames ? 1 : 2));
  return { shapes, scale_m: weighted };
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
  return asTexture(padded, THREE.HalfFloatType);
}

function texturesOf(splat, { triangles, vertices, carriers }, harmonics) {
  const corners = new Float32Array(8 * splat.G);
  for (let g = 0; g < splat.G; g++) {
    const face = splat.face_of[g];
    if (face < 0) continue; // stays still: its fourth number is 0
    for (let c = 0; c < 3; c++) {
      corners[8 * g + c] = triangles[3 * face + c];
      corners[8 * g + 4 + c] = splat.weights[3 * g + c];
    }
    corners[8 * g + 3] = 1;
  }
  const rest = new Float32Array((4 * vertices.length) / 3);
  for (let v = 0; v < vertices.length / 3; v++) rest.set(vertices.subarray(3 * v, 3 * v + 3), 4 * v);
  return {
    corners: texture(corners),
    rest: texture(rest),
    bones: texture(carriers),
    sh: harmonicsTexture(splat, harmonics),
  };
}

function texture(values) {
  const padded = new Float32Array(4 * WIDTH * Math.max(1, Math.ceil(values.length / 4 / WIDTH)));
  padded.set(values);
  return asTexture(padded, THREE.FloatType);
}

function asTexture(padded, type) {
  const made = new THREE.DataTexture(padded, WIDTH, padded.length / 4 / WIDTH, THREE.RGBAFormat, type);
  made.needsUpdate = true;
  return made;
}
